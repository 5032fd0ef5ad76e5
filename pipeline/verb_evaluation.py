"""What a run says about verbs: accuracy by source of poses, beside how good these poses are (paper, Table 5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from assemblyhands_core.metrics.verbs import TABLE
from pipeline.grids import Grid, rich_table
from pipeline.set_tables import figure_with_interval, labelled_rows, write_rows

CLASSIFIERS: Final = {
    "verb_table": "shipped network, our annotation",
    "verb_table_manual": "shipped network, people's labels",
    "own_verb_table": "trained on each source, our annotation",
    "own_verb_table_manual": "trained on each source, people's labels",
}
"""Node → what readers call the classifier that it judges, and whose labels its poses come from."""
_COLUMNS: Final = {
    "mean_verb_accuracy": "mean over verbs (%)",
    "accuracy": "over segments (%)",
    "relative_mean_verb_accuracy": "of the upper bound (%)",
    "pose_error_mm": "pose error (mm)",
    "pose_coverage": "observed, of 30 Hz (%)",
}


def print_verbs(console: Console, run: Path) -> None:
    """Print a table for each kind of labels, and write all figures to `report/verbs.csv`; nothing without any."""
    rows = verb_rows(run)
    for name in dict.fromkeys(row["classifier"] for row in rows):
        console.print(rich_table(verb_grid(name, [row for row in rows if row["classifier"] == name])))
    if rows:
        write_rows(run / "report" / "verbs.csv", rows)


def verb_rows(run: Path) -> list[dict[str, Any]]:
    """Return all figures about verbs, with the `classifier` that each is of."""
    return list(labelled_rows(run, CLASSIFIERS, "classifier"))


def verb_grid(name: str, rows: Sequence[Mapping[str, Any]]) -> Grid:
    """Return a line for each source of poses, and for chance, of one classifier's figures."""
    found = {(row["table"], row["group"], row["row"], row["metric"]): row for row in rows}
    verbs = list(dict.fromkeys(row["group"] for row in rows if row["table"] == f"{TABLE}_by_verb"))
    lines = []
    for source in dict.fromkeys(row["row"] for row in rows if row["table"] == TABLE):
        by_verb = [found.get((f"{TABLE}_by_verb", verb, source, "accuracy")) for verb in verbs]
        overall = [found.get((TABLE, "", source, metric)) for metric in _COLUMNS]
        values = [*(_plain(row) for row in by_verb), *(figure_with_interval(row, 1) for row in overall)]
        lines.append([source, *values, str(found[TABLE, "", source, "accuracy"]["n"])])
    return Grid(f"verbs, {name} (95 % intervals)", ["poses", *verbs, *_COLUMNS.values(), "n"], lines)


def _plain(row: Mapping[str, Any] | None) -> str:
    return "–" if row is None or row["value"] != row["value"] else f"{row['value']:.0f}"
