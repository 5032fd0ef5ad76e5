"""Remove what no run refers to."""

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from assemblyhands_core.data.store import Store
from pipeline.config import GcConfig
from pipeline.history import History


@dataclass(frozen=True)
class Garbage:
    """What ``gc`` removes: old runs' views, entries that no kept run refers to, leftovers of killed runs."""

    runs: list[Path]
    entries: list[Path]
    leftovers: list[Path]

    @property
    def num_bytes(self) -> int:
        """Return the size of all files, without what links point to."""
        return sum(_size(path) for path in (*self.runs, *self.entries, *self.leftovers))

    def remove(self) -> None:
        """Delete it all."""
        for path in (*self.runs, *self.entries, *self.leftovers):
            shutil.rmtree(path)


def find_garbage(workspace: Path, config: GcConfig) -> Garbage:
    """Return what may be removed. The caller holds the workspace's lock, so that no run is under way."""
    runs = History(workspace).runs
    store = Store(workspace)
    kept = set(_referenced(runs[: config.keep_runs]))
    entries = [path for path in store.entries() if (path.parent.name, path.name) not in kept]
    return Garbage(runs[config.keep_runs :], entries, list(store.leftovers()))


def _referenced(runs: Iterable[Path]) -> Iterable[tuple[str, str]]:
    for run in runs:
        for path in run.glob("*/manifest.json"):
            manifest = json.loads(path.read_text())
            yield from ((manifest["stage"], shard["key"]) for shard in manifest["shards"].values())


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*"))
