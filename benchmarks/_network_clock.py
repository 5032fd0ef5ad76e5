"""How long a network runs within a stage, over all threads; a part of the benchmarks beside it."""

import threading
import time
from typing import Any


class NetworkClock:
    """Seconds of forward passes; `seconds` may be set to 0 between measurements."""

    def __init__(self) -> None:
        self.seconds, self.lock = 0.0, threading.Lock()

    def wrapped(self, forward: Any) -> Any:
        """Return the same forward pass, timed."""

        def timed(*arguments: Any) -> Any:
            begin = time.perf_counter()
            found = forward(*arguments)
            with self.lock:
                self.seconds += time.perf_counter() - begin
            return found

        return timed
