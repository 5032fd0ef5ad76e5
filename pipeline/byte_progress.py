"""Show how far something is that reads many bytes: a bar in a terminal, a line now and then elsewhere."""

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from pipeline.terminal import say

_SECONDS_BETWEEN_LINES = 5.0


class ByteProgress:
    """Counts bytes."""

    def __init__(self, console: Console, what: str, num_bytes: int) -> None:
        self._console = console
        self._started = self._last_line = time.monotonic()
        columns = (TextColumn(what), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
        self._bar = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
        self._row = self._bar.add_task(what, total=num_bytes)
        self._what, self._total, self._done = what, num_bytes, 0

    def __enter__(self) -> "ByteProgress":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def advance(self, num_bytes: int) -> None:
        """Note that so many bytes more are done."""
        self._done += num_bytes
        self._bar.update(self._row, advance=num_bytes)
        now = time.monotonic()
        if not self._console.is_terminal and now - self._last_line >= _SECONDS_BETWEEN_LINES:
            self._last_line = now
            self._print_line(now - self._started)

    def _print_line(self, seconds: float) -> None:
        left = f", about {seconds * (self._total - self._done) / self._done:.0f} s to go" if self._done else ""
        line = f"{self._what}: {self._done / 1e9:.2f} of {self._total / 1e9:.2f} GB{left}"
        say(self._console, line)
