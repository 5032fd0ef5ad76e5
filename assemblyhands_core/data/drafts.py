"""Files that are there whole or not at all: each is written beside its place and renamed into it."""

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def draft_beside(path: Path) -> Path:
    """Return a hidden name beside a path that no other process has, on this host or another that shares the folder."""
    return path.with_name(f".{path.name}-{uuid.uuid4().hex[:16]}")


@contextmanager
def replaced_whole(path: Path) -> Iterator[Path]:
    """Give a draft of a file or link, its folder made; without error it takes the path's place, else it vanishes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = draft_beside(path)
    try:
        yield draft
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
