"""What the folders of runs promise: which command made an entry of the store, and whether all links lead somewhere."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.history import History


@dataclass
class RunFolders:
    """What was read in the folders of all runs.

    Attributes:
        commands: the newest command line that refers to an entry, by its stage and key.
        flaws: a sentence about each file that is damaged, and each node of a run whose tables are gone.
    """

    commands: dict[tuple[str, str], str] = field(default_factory=dict)
    flaws: list[str] = field(default_factory=list)


def read_run_folders(workspace: Path) -> RunFolders:
    """Return what the folders of all runs promise."""
    found = RunFolders()
    for run in reversed(History(workspace).runs):  # the newest last, so that its command counts
        command = _read(run / "run.json", found).get("command", "")
        for manifest in sorted(run.glob("*/manifest.json")):
            _read_node(manifest, command or f"the command of run {run.name}", found)
    return found


def _read_node(manifest: Path, command: str, found: RunFolders) -> None:
    values = _read(manifest, found)
    for shard in values.get("shards", {}).values():
        found.commands[values["stage"], shard["key"]] = command
    dangling = list(_dangling(manifest.parent))
    if dangling:
        first = dangling[0].relative_to(manifest.parent)
        found.flaws.append(
            f"{manifest.parent}: {len(dangling)} of its tables are no longer in the store, the first is {first}; "
            f"made anew by: {command} (or remove {manifest.parents[1]})"
        )


def _dangling(node: Path) -> Iterator[Path]:
    return (link for link in sorted(node.glob("*/*.parquet")) if not link.exists())


def _read(path: Path, found: RunFolders) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(values, dict):
            return values
        reason = "it holds no object"
    except (OSError, ValueError) as error:
        reason = str(error)
    found.flaws.append(
        f"{path}: it cannot be read ({reason}), so what its run refers to is unknown; "
        f"run its command again, then remove the run's folder"
    )
    return {}
