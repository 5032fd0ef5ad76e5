"""A log file per shard: Python's log records, warnings and whatever native libraries print to standard error."""

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"


@contextmanager
def shard_log(path: Path) -> Iterator[None]:
    """Send everything that is logged or printed to standard error to a file meanwhile."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        handler = logging.StreamHandler(file)
        handler.setFormatter(logging.Formatter(_FORMAT))
        logger = logging.getLogger()
        logger.addHandler(handler)
        try:
            with _standard_error_in(file.fileno()):
                yield
        finally:
            logger.removeHandler(handler)


@contextmanager
def _standard_error_in(descriptor: int) -> Iterator[None]:
    # MediaPipe and FFmpeg print from C++, past sys.stderr: only the descriptor itself catches them.
    sys.stderr.flush()
    kept = os.dup(2)
    os.dup2(descriptor, 2)
    try:
        yield
    finally:
        sys.stderr.flush()
        os.dup2(kept, 2)
        os.close(kept)
