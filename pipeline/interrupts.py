"""Ctrl-C that is never lost: Python drops the exception where it strikes in a finalizer or a callback of a library."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_seen: list[int] = []


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Note every Ctrl-C beside raising it; use it in the main thread."""
    _seen.clear()
    previous = signal.signal(signal.SIGINT, _note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def check_interrupted() -> None:
    """Raise the interrupt that came and got lost, if one did.

    Raises:
        KeyboardInterrupt: the user wants to stop.
    """
    if _seen:
        raise KeyboardInterrupt


def _note(signum: int, frame: FrameType | None) -> None:
    _seen.append(signum)
    raise KeyboardInterrupt
