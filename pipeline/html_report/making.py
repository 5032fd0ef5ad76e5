"""How a run was made: time by stage, command, parameters, versions, digests and keys."""

import json
from collections.abc import Mapping
from typing import Any, Final

from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.page import Block, Fold, Section, Table, Text
from pipeline.summary import quality_grids

_FACTS: Final = ("command", "time", "commit", "python", "machine")
_MAX_QUALITY_TABLES: Final = 60


def quality(run: FinishedRun) -> Section:
    """Return what is known of each sequence's annotation without truth."""
    grids = quality_grids(run.folder)
    if not grids:
        return Section("Quality without truth", [Text("This run made no quality tables: `annotate` does.")])
    folds: list[Block] = [
        Fold(name, [Table(grid) for grid in grids[:_MAX_QUALITY_TABLES] if grid.title == name])
        for name in dict.fromkeys(grid.title for grid in grids[:_MAX_QUALITY_TABLES])
    ]
    if len(grids) > _MAX_QUALITY_TABLES:
        folds.append(Text(f"{len(grids) - _MAX_QUALITY_TABLES} more tables are in quality/quality/*.parquet."))
    return Section("Quality without truth", folds)


def times(run: FinishedRun) -> Section:
    """Return the time that each node's results took when they were made."""
    found = [(name, manifest["stage"], _seconds(manifest)) for name, manifest in run.manifests.items()]
    if not found:
        return Section("Time", [Text("This run says nothing about time.")])
    total = sum(sum(seconds) for _, _, seconds in found)
    rows = [
        [name, stage, str(len(seconds)), *_of_node(seconds), _percent(sum(seconds), total)]
        for name, stage, seconds in found
    ]
    columns = ["node", "stage", "shards", "all shards (s)", "mean (s)", "slowest shard (s)", "share (%)"]
    note = (
        f"Together {total / 3600:.2f} hours of work on {run.record.get('machine', 'an unknown machine')}; results that "
        "an earlier run made count with the time that they took then, and shards run side by side."
    )
    return Section("Time", [Table(Grid("Time by node", columns, rows), note=note)])


def provenance(run: FinishedRun) -> Section:
    """Return what it takes to make the run again, and to know that the results are the same."""
    record = run.record
    if not record:
        return Section("Provenance", [Text("This run has no run.json.")])
    facts = [[name, value] for name, value in _facts(record)]
    digests = [[node, digest] for node, digest in record.get("digests", {}).items()]
    values = [[name, value] for name, value in _flat(record.get("config", {}))]
    keys = [
        [shard, name, result["key"]]
        for name, manifest in run.manifests.items()
        for shard, result in manifest.get("shards", {}).items()
    ]
    folded = {
        "Content digests by node": Grid("Equal digests mean equal contents", ["node", "sha256"], digests),
        "Parameters": Grid("As run.json has them", ["parameter", "value"], values),
        "Keys of the store's entries": Grid("As each node's manifest.json has them", ["shard", "node", "key"], keys),
    }
    folds = [Fold(title, [Table(grid)]) for title, grid in folded.items()]
    return Section("Provenance", [Table(Grid("Command and versions", ["what", "value"], facts)), *folds])


def parameters(run: FinishedRun) -> list[tuple[str, str]]:
    """Return what a run was made with: command, versions and every parameter."""
    return [*_facts(run.record), *_flat(run.record.get("config", {}))]


def _facts(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = [(name, str(record.get(name, "–"))) for name in _FACTS]
    return facts + [(name, str(number)) for name, number in record.get("versions", {}).items()]


def _seconds(manifest: Mapping[str, Any]) -> list[float]:
    return [shard["seconds"] for shard in manifest.get("shards", {}).values()]


def _of_node(seconds: list[float]) -> list[str]:
    if not seconds:
        return ["–"] * 3
    return [f"{value:.1f}" for value in (sum(seconds), sum(seconds) / len(seconds), max(seconds))]


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f}" if whole > 0 else "–"


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return dotted names and values as the command line takes them."""
    pairs: list[tuple[str, str]] = []
    for name, value in values.items():
        dotted = f"{prefix}{name}".removeprefix("stages.")
        pairs += _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else [(dotted, json.dumps(value))]
    return pairs
