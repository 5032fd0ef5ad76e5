"""How a run was made: time by stage, command, parameters, versions, digests and keys."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.page import Block, Fold, Table, Text
from pipeline.measured import NothingToShow
from pipeline.summary import quality_grids

_FACTS: Final = ("command", "time", "commit", "python", "machine")
_MAX_QUALITY_TABLES: Final = 60


def quality(run: FinishedRun) -> Iterator[Block]:
    """Yield what is known of each sequence's annotation without truth."""
    grids = quality_grids(run.folder)
    if not grids:
        raise NothingToShow("this run made no quality tables: `annotate` does.")
    for name in dict.fromkeys(grid.title for grid in grids[:_MAX_QUALITY_TABLES]):
        yield Fold(name, [Table(grid) for grid in grids[:_MAX_QUALITY_TABLES] if grid.title == name])
    if len(grids) > _MAX_QUALITY_TABLES:
        yield Text(f"{len(grids) - _MAX_QUALITY_TABLES} more tables are in quality/quality/*.parquet.")


def times(run: FinishedRun) -> Iterator[Block]:
    """Yield the time that each node's results took when they were made, and the room that they take."""
    found = [(name, run.manifests[name]["stage"], seconds) for name, seconds in node_seconds(run).items()]
    if not found:
        raise NothingToShow("this run says nothing about time.")
    total = sum(sum(seconds) for _, _, seconds in found)
    rows = [
        [
            name,
            stage,
            str(len(seconds)),
            *_of_node(seconds),
            _percent(sum(seconds), total),
            _megabytes(run.folder / name),
        ]
        for name, stage, seconds in found
    ]
    columns = ["node", "stage", "shards", "all shards (s)", "mean (s)", "slowest shard (s)", "share (%)", "stored (MB)"]
    note = (
        f"Together {total / 3600:.2f} hours of work on {run.record.get('machine', 'an unknown machine')}; results that "
        "an earlier run made count with the time that they took then, and shards run side by side."
    )
    share = columns.index("share (%)")
    yield Table(Grid("Time and room by node", columns, rows), shaded=range(share, share + 1), note=note)


def node_seconds(run: FinishedRun) -> dict[str, list[float]]:
    """Return the time that each node's shards took when they were made."""
    shards = {name: manifest.get("shards", {}).values() for name, manifest in run.manifests.items()}
    return {name: [shard["seconds"] for shard in of_node] for name, of_node in shards.items()}


def provenance(run: FinishedRun) -> Iterator[Block]:
    """Yield what it takes to make the run again, and to know that the results are the same."""
    record = run.record
    if not record:
        raise NothingToShow("this run's run.json is empty.")
    facts = [[name, value] for name, value in _facts(record)]
    digests = [[node, digest] for node, digest in record.get("digests", {}).items()]
    values = [[name, value] for name, value in _used_parameters(run)]
    keys = [
        [shard, name, result["key"]]
        for name, manifest in run.manifests.items()
        for shard, result in manifest.get("shards", {}).items()
    ]
    folded = {
        "Content digests by node": Grid("Equal digests mean equal contents", ["node", "sha256"], digests),
        "Parameters": Grid("Of the run and of the stages that it made something of", ["parameter", "value"], values),
    }
    yield Table(Grid("Command and versions", ["what", "value"], facts))
    for title, grid in folded.items():
        yield Fold(title, [Table(grid)])
    grid = Grid("As each node's manifest.json has them", ["shard", "node", "key"], keys)
    yield Fold("Keys of the store's entries", [Table(grid)], is_printed=False)


def parameters(run: FinishedRun) -> list[tuple[str, str]]:
    """Return what a run was made with: command, versions and parameters."""
    return [*_facts(run.record), *_used_parameters(run)]


def _used_parameters(run: FinishedRun) -> list[tuple[str, str]]:
    """Return the run's own parameters and those of its stages; others had no part in it."""
    config = dict(run.record.get("config", {}))
    used = {manifest["stage"] for manifest in run.manifests.values()}
    stages = {name: values for name, values in config.pop("stages", {}).items() if name in used}
    return [*_flat(config), *_flat(stages)]


def _facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = [(name, str(record.get(name, "–"))) for name in _FACTS]
    return facts + [(name, str(number)) for name, number in record.get("versions", {}).items()]


def _of_node(seconds: list[float]) -> list[str]:
    if not seconds:
        return ["–"] * 3
    return [f"{value:.1f}" for value in (sum(seconds), sum(seconds) / len(seconds), max(seconds))]


def _megabytes(node: Path) -> str:
    """Return the size of a node's entries in the store; of those that are still there."""
    entries = {link.resolve().parent for link in node.glob("*/*.parquet") if link.exists()}
    files = (file for entry in entries for file in entry.rglob("*") if file.is_file())
    return f"{sum(file.stat().st_size for file in files) / 1e6:.1f}"


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f}" if whole > 0 else "–"


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return dotted names and values as the command line takes them."""
    pairs: list[tuple[str, str]] = []
    for name, value in values.items():
        dotted = f"{prefix}{name}"
        pairs += _flat(value, f"{dotted}.") if isinstance(value, Mapping) else [(dotted, json.dumps(value))]
    return pairs
