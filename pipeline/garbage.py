"""Remove what no run refers to."""

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assemblyhands_core.data.store import Store
from pipeline.config import GcConfig, UserError
from pipeline.history import History


@dataclass(frozen=True)
class Garbage:
    """What ``gc`` removes: views and logs of old runs, entries that no kept run refers to, leftovers of killed runs."""

    runs: list[Path]
    logs: list[Path]
    entries: list[Path]
    leftovers: list[Path]

    @property
    def folders(self) -> list[Path]:
        """Return all folders that go."""
        return [*self.runs, *self.logs, *self.entries, *self.leftovers]

    @property
    def num_bytes(self) -> int:
        """Return the size of all files, without what links point to."""
        return sum(_size(path) for path in self.folders)

    def remove(self) -> None:
        """Delete it all."""
        for path in self.folders:
            shutil.rmtree(path)


def find_garbage(workspace: Path, config: GcConfig) -> Garbage:
    """Return what may be removed, never what ``latest`` points to.

    The caller holds the workspace's lock, so that no run is under way.
    """
    runs, latest = History(workspace).runs, (workspace / "runs" / "latest").resolve()
    store = Store(workspace)
    old = [run for run in runs[config.keep_runs :] if run.resolve() != latest]
    kept_runs = [run for run in runs if run not in old]
    kept = set(_referenced(kept_runs))
    seen_ns = max((path.stat().st_mtime_ns for run in runs for path in [run / "run.json"]), default=0)
    # What is newer than every view belongs to a run that was killed and will go on.
    entries = [
        path
        for path in store.entries()
        if (path.parent.name, path.name) not in kept and path.stat().st_mtime_ns <= seen_ns
    ]
    kept_names = {run.name for run in kept_runs}
    logs = [path for path in _subfolders(workspace / "logs") if path.name not in kept_names]
    drafts = [path for path in _subfolders(workspace / "runs") if path.name.startswith(".")]
    return Garbage(old, logs, entries, [*store.leftovers(), *drafts])


def _referenced(runs: Iterable[Path]) -> Iterable[tuple[str, str]]:
    for run in runs:
        for path in run.glob("*/manifest.json"):
            manifest = _read(path)
            yield from ((manifest["stage"], shard["key"]) for shard in manifest["shards"].values())


def _read(manifest: Path) -> Any:
    try:
        return json.loads(manifest.read_text())
    except ValueError as error:
        raise UserError(
            f"{manifest} is damaged ({error}), so what its run needs is unknown; remove {manifest.parents[1]} first"
        ) from error


def _subfolders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*") if path.is_dir() and not path.is_symlink())


def _size(folder: Path) -> int:
    return sum(path.lstat().st_size for path in folder.rglob("*"))
