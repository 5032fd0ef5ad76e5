"""Networks that stay in a worker's memory from one shard to the next."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

from assemblyhands_core.data.digests import digest_file

Loaded = TypeVar("Loaded")

_NUM_KEPT: Final = 4


def load_once(load: Callable[[Path], Loaded], path: Path) -> Loaded:
    """Return what `load(path)` gives, from memory where the same bytes were loaded before.

    The digest takes milliseconds where building a network takes a tenth of a second. Callers share what they get, so
    nobody may change it; training loads networks of its own.
    """
    loaded: Loaded = _loaded(load, path, digest_file(path))
    return loaded


@lru_cache(_NUM_KEPT)
def _loaded(load: Callable[[Path], Any], path: Path, digest: str) -> Any:
    return load(path)
