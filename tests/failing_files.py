"""A layer between us and the files that fails: Python tells of every file that it opens, makes, renames or removes."""

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

_CHANGING = {"os.mkdir", "os.rename", "os.symlink", "os.link", "os.truncate"}
_NOT_READING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


@dataclass
class FailingFiles:
    """Counts the places where something below a folder is written, and fails at one of them or from it on.

    Attributes:
        folder: what lies elsewhere is left in peace.
        first, last: write points that fail, counted from 0.
        points: what was asked for so far.
    """

    folder: Path
    first: int = sys.maxsize
    last: int = sys.maxsize
    points: list[str] = field(default_factory=list)

    def reach(self, what: str, path: Any) -> None:
        """Note a write point; raise if it is one that fails."""
        if not isinstance(path, str | bytes | os.PathLike) or not Path(os.fsdecode(path)).is_relative_to(self.folder):
            return
        self.points.append(f"{what} {Path(os.fsdecode(path)).name}")
        if self.first <= len(self.points) - 1 <= self.last:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), os.fsdecode(path))


_layers: list[FailingFiles] = []  # an audit hook stays for ever, so there is one for all tests


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _layers:
        return
    if event in _CHANGING:
        _layers[-1].reach(event, arguments[1] if event in {"os.rename", "os.symlink"} else arguments[0])
    elif event == "open" and (arguments[2] or 0) & _NOT_READING:
        _layers[-1].reach("open", arguments[0])


sys.addaudithook(_hook)


@contextmanager
def failing_files(folder: Path, first: int = sys.maxsize, last: int = sys.maxsize) -> Iterator[FailingFiles]:
    """Let the write points from ``first`` to ``last`` below a folder fail as on a full disk."""
    layer = FailingFiles(folder, first, last)
    write_table: Callable[..., None] = pq.write_table

    def write(table: Any, where: Any, **options: Any) -> None:  # Arrow writes by itself, of which Python is not told
        layer.reach("parquet begins", where)
        write_table(table, where, **options)
        try:
            layer.reach("parquet ends", where)
        except OSError:
            os.truncate(where, Path(where).stat().st_size // 2)
            raise

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pq, "write_table", write)
        _layers.append(layer)
        try:
            yield layer
        finally:
            _layers.remove(layer)
