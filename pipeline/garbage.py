"""Remove what no run refers to."""

import json
import os
import shutil
import time
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assemblyhands_core.data.store import Store
from pipeline.config import GcConfig, UserError
from pipeline.history import History
from pipeline.tasks import scratch_folder

_SECONDS_A_DAY = 86400


@dataclass(frozen=True)
class Garbage:
    """What ``gc`` removes.

    Attributes:
        runs, logs: views and logs of old runs.
        entries: entries that no kept run refers to.
        leftovers: what killed runs and damaged entries left behind: drafts, certificates.
        scratch: what interrupted computations would go on from, if it is no longer of use.
    """

    runs: list[Path]
    logs: list[Path]
    entries: list[Path]
    leftovers: list[Path]
    scratch: list[Path]

    @property
    def folders(self) -> list[Path]:
        """Return all folders that go."""
        return [*self.runs, *self.logs, *self.entries, *self.leftovers, *self.scratch]

    @property
    def num_bytes(self) -> int:
        """Return the size of all files, without what links point to."""
        return sum(num_bytes_below(path) for path in self.folders)

    def remove(self) -> None:
        """Delete it all."""
        for path in self.folders:
            with suppress(FileNotFoundError):  # a plan beside us may set a half-removed entry aside
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
    logs = [path for path in subfolders(workspace / "logs") if path.name not in kept_names]
    drafts = [path for path in subfolders(workspace / "runs") if path.name.startswith(".")]
    scratch = list(_idle_scratch(workspace, kept, config.keep_scratch_days))
    # A run that is under way after all, where the lock holds on one host only, needs its certificate until its end.
    certificates = [path for path in subfolders(workspace / "tls") if _is_old(path, config.keep_scratch_days)]
    return Garbage(old, logs, entries, [*store.leftovers(), *drafts, *certificates], scratch)


def _idle_scratch(workspace: Path, kept: Collection[tuple[str, str]], keep_days: float) -> Iterable[Path]:
    """Yield scratch whose result is there, and what nobody went on with for long, unless a kept run lost its result."""
    whole = {scratch_folder(workspace, path.parent.name, path.name) for path in Store(workspace).entries()}
    wanted = {scratch_folder(workspace, stage, key) for stage, key in kept} - whole
    for folder in subfolders(workspace / "scratch"):
        if folder in whole or (folder not in wanted and _is_old(folder, keep_days)):
            yield folder


def _is_old(folder: Path, keep_days: float) -> bool:
    """Whether nobody changed anything in a folder for so many days."""
    changed_s = max(path.lstat().st_mtime for path in [folder, *folder.rglob("*")])
    return changed_s < time.time() - keep_days * _SECONDS_A_DAY


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


def subfolders(folder: Path) -> list[Path]:
    """Return the folders in a folder, without links."""
    return sorted(path for path in folder.glob("*") if path.is_dir() and not path.is_symlink())


def num_bytes_below(folder: Path) -> int:
    """Return the size of all files in a folder, without what links point to."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):  # a run may be at work
                total += Path(place, name).lstat().st_size
    return total
