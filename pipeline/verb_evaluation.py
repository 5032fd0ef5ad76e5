"""What a run says about verbs: accuracy by source of poses, beside how good these poses are (paper, Table 5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from assemblyhands_core.metrics.verbs import TABLE
from pipeline.set_tables import figure_with_interval, labelled_rows, write_rows

_NODES: Final = {
    "verb_table": "shipped network, our annotation",
    "verb_table_manual": "shipped network, people's labels",
    "own_verb_table": "trained on each source, our annotation",
    "own_verb_table_manual": "trained on each source, people's labels",
}
_COLUMNS: Final = {
    "mean_verb_accuracy": "mean over verbs (%)",
    "accuracy": "over segments (%)",
    "relative_mean_verb_accuracy": "of the upper bound (%)",
    "pose_error_mm": "pose error (mm)",
}


def print_verbs(console: Console, run: Path) -> None:
    """Print a table for each kind of labels, and write all figures to `report/verbs.csv`; nothing without any."""
    rows = list(labelled_rows(run, _NODES, "classifier"))
    for name in dict.fromkeys(row["classifier"] for row in rows):
        console.print(_table(name, [row for row in rows if row["classifier"] == name]))
    if rows:
        write_rows(run / "report" / "verbs.csv", rows)


def _table(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    found = {(row["table"], row["group"], row["row"], row["metric"]): row for row in rows}
    verbs = list(dict.fromkeys(row["group"] for row in rows if row["table"] == f"{TABLE}_by_verb"))
    table = Table("poses", *verbs, *_COLUMNS.values(), "n", title=f"verbs, {name} (95 % intervals)")
    for source in dict.fromkeys(row["row"] for row in rows if row["table"] == TABLE):
        by_verb = [found.get((f"{TABLE}_by_verb", verb, source, "accuracy")) for verb in verbs]
        overall = [found.get((TABLE, "", source, metric)) for metric in _COLUMNS]
        values = [*(_plain(row) for row in by_verb), *(figure_with_interval(row, 1) for row in overall)]
        table.add_row(source, *values, str(found[TABLE, "", source, "accuracy"]["n"]))
    return table


def _plain(row: Mapping[str, Any] | None) -> str:
    return "–" if row is None or row["value"] != row["value"] else f"{row['value']:.0f}"
