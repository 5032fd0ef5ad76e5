"""What earlier runs did: read from the manifests under ``work/runs``, newest first."""

import json
from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.entry_records import Record
from assemblyhands_core.data.store import Store
from pipeline.graph import Node
from pipeline.tasks import Shard

_NUM_WEIGHED: Final = 20
"""Shards that tell how much room one takes."""


class History:
    """The runs of a workspace."""

    def __init__(self, workspace: Path) -> None:
        self._runs = workspace / "runs"
        self._manifests: dict[tuple[Path, str], Mapping[str, Any]] = {}

    @cached_property
    def runs(self) -> list[Path]:
        """Return the folders of all runs, newest first."""
        folders = [path.parent for path in self._runs.glob("[!.]*/run.json") if not path.parent.is_symlink()]
        return sorted(folders, key=lambda path: (path / "run.json").stat().st_mtime_ns, reverse=True)

    def last_record(self, node: Node, shard: Shard, store: Store) -> Record | None:
        """Return the record of the newest run that has this shard, if its entry is still there."""
        for run in self.runs:
            if entry := self._shards(run, node.name).get(str(shard)):
                return store.find(node.stage.name, entry["key"])
        return None

    def mean_seconds(self, node: Node) -> float | None:
        """Return the mean time that a shard of this node took, from the newest run that has it."""
        for run in self.runs:
            if shards := self._shards(run, node.name):
                return float(sum(entry["seconds"] for entry in shards.values()) / len(shards))
        return None

    def mean_bytes(self, node: Node, store: Store) -> float | None:
        """Return the mean room that a shard of this node takes in the store, from the newest run that has it."""
        for run in self.runs:
            keys = [entry["key"] for entry in self._shards(run, node.name).values()][:_NUM_WEIGHED]
            if sizes := [size for key in keys if (size := _size(store.entry(node.stage.name, key)))]:
                return sum(sizes) / len(sizes)
        return None

    def mean_shards(self, node: Node) -> float:
        """Return how many shards of this node a sequence has on average in the newest run that has it, or 0."""
        for run in self.runs:
            if shards := self._shards(run, node.name):
                return len(shards) / len({name.rpartition(".")[0] or name for name in shards})
        return 0.0

    def _shards(self, run: Path, node: str) -> Mapping[str, Any]:
        if (run, node) not in self._manifests:
            self._manifests[run, node] = _read(run / node / "manifest.json").get("shards", {})
        return self._manifests[run, node]


def _size(entry: Path) -> int:
    """Return how many bytes an entry's files have; 0 if it is gone."""
    with suppress(OSError):
        return sum(path.stat().st_size for path in entry.iterdir())
    return 0


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}
