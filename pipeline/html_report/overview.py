"""The page's first part: how much was found, and what was left out or failed."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import pyarrow.parquet as pq

from assemblyhands_core.metrics.annotation import TABLE
from assemblyhands_core.viz.figures import method_label
from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.annotation import bound_last, pool_title
from pipeline.html_report.page import Block, Fold, Table, Text
from pipeline.set_tables import figure_with_interval

NOT_COMPARABLE: Final = (
    "Every figure of this page is on synthetic recordings; the paper's are on recordings of real people. They are not "
    "comparable; only the order of the methods is."
)
_OF_OTHERS: Final = (
    "The paper's figures are on its own recordings; those of this run are comparable only if it has the same."
)
_COLUMNS: Final = {
    "coverage": "found (%)",
    "mpjpe_mm": "MPJPE of found (mm)",
    "pck_auc": "PCK-AUC, missing as wrong (%)",
}


def summary(run: FinishedRun) -> Iterator[Block]:
    """Yield how much was found, how well where that is known, and what is not in the figures."""
    yield Text(NOT_COMPARABLE if run.is_synthetic else _OF_OTHERS, is_warning=True)
    yield from _failures(run)
    found = [*_judged(run), *_outcomes(run)]
    yield from found or [Text("This run annotated nothing.")]
    yield from _left_out(run)


def _judged(run: FinishedRun) -> Iterator[Block]:
    """Yield coverage first, then errors, of every method over each kind of sequences."""
    for pool in run.measured.pools:
        found: dict[str, dict[str, Mapping[str, Any]]] = defaultdict(dict)
        for cell in run.measured.cells[pool.name]:
            if cell.table == TABLE:
                found[cell.row][cell.metric] = cell._asdict()
        rows = [
            [
                method_label(method),
                *(figure_with_interval(metrics[name]) for name in _COLUMNS),
                str(metrics["pck_auc"]["n"]),
            ]
            for method, metrics in found.items()
        ]
        if rows:
            title = f"Coverage and errors, {pool_title(pool)} (95 % intervals)"
            yield Table(Grid(title, ["method", *_COLUMNS.values(), "joints labelled"], bound_last(rows)))
        for name in pool.left_out:
            yield Text(f"{name} is not in these figures: not all methods were evaluated there.")


def _outcomes(run: FinishedRun) -> Iterator[Block]:
    """Yield what became of the joints in each round, whether the truth is known or not."""
    counts = {
        name: run.joint_reasons(name)
        for name in run.manifests
        if name.startswith("round_") or name in ("smoothed", "ego_only", "ego_only_manual")
    }
    reasons = list(dict.fromkeys(reason for of_node in counts.values() for reason in of_node if reason))
    rows = [
        [node, *(_percent(of_node.get(reason, 0), sum(of_node.values())) for reason in ["", *reasons]), str(total)]
        for node, of_node in counts.items()
        if (total := sum(of_node.values()))
    ]
    if rows:
        columns = ["node", "found (%)", *(f"{reason.replace('_', ' ')} (%)" for reason in reasons), "joints looked for"]
        yield Table(
            Grid("What became of the joints", columns, rows), note="Missing joints have one of the named reasons."
        )


def _failures(run: FinishedRun) -> Iterator[Block]:
    failures: Sequence[Mapping[str, str]] = run.record.get("failures", [])
    if failures:
        yield Text(f"{len(failures)} shards were not finished; what follows is without them.", is_warning=True)
        rows = [[row["node"], row["shard"], row["status"], row["error"]] for row in failures]
        yield Table(Grid("Not finished", ["node", "shard", "status", "reason"], rows))


def _left_out(run: FinishedRun) -> Iterator[Block]:
    """Yield which views were not used."""
    rows = []
    for path in sorted((run.folder / "ingest" / "views").glob("*.parquet")):
        by_reason: dict[str, list[str]] = defaultdict(list)
        for view in pq.read_table(path.resolve(), columns=["camera_id", "reason"]).to_pylist():
            by_reason[view["reason"]].append(view["camera_id"])
        num_views = sum(map(len, by_reason.values()))
        rows += [
            [path.stem, reason.replace("_", " "), f"{len(names)} of {num_views}", ", ".join(names)]
            for reason, names in by_reason.items()
            if reason
        ]
    if rows:
        grid = Grid("Views by reason", ["sequence", "reason", "views", "cameras"], rows)
        yield Fold(f"Views that were not used: of {len({row[0] for row in rows})} sequences", [Table(grid)])


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f}"
