"""What a run says about its egocentric networks: each trained one against each kind of labels (paper, Table 4)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from assemblyhands_core.metrics.egocentric import TABLE
from pipeline.grids import Grid, rich_table
from pipeline.set_tables import figure_with_interval, labelled_rows, write_rows

NETWORKS: Final = {
    "ego_evaluation": "shipped",
    "ego_evaluation_manual": "Train-M",
    "ego_evaluation_automatic": "Train-A",
    "ego_evaluation_both": "Train-M+A",
    "ego_evaluation_tracked": "Train-T",
}
"""Node → what readers call the network that it judges."""
LABELS: Final = {"manual": "Eval-M", "automatic": "Eval-A", "both": "Eval-M+A"}
"""Kind of labels → what readers call judging by them."""
_COLUMNS: Final = {
    "wrist_relative_mpjpe_mm": "wrist-relative MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "identity_accuracy": "hand identity (%)",
    "coverage": "coverage (%)",
}


def print_egocentric(console: Console, run: Path) -> None:
    """Print the networks' figures, and write all of them to the run's `report/ego_cross.csv`; nothing without any."""
    rows = egocentric_rows(run)
    if rows:
        console.print(rich_table(egocentric_grid(rows)))
        write_rows(run / "report" / "ego_cross.csv", rows)


def egocentric_rows(run: Path) -> list[dict[str, Any]]:
    """Return all figures of a run's egocentric networks, with the `network` that each is of."""
    return list(labelled_rows(run, NETWORKS, "network"))


def egocentric_grid(rows: Sequence[Mapping[str, Any]]) -> Grid:
    """Return a line for each network and each kind of labels, over all crops."""
    found = {
        (row["network"], row["row"], row["metric"]): row for row in rows if (row["table"], row["group"]) == (TABLE, "")
    }
    lines = [
        [network, name, *(figure_with_interval(found[network, labels, metric]) for metric in _COLUMNS), str(first["n"])]
        for network in dict.fromkeys(row["network"] for row in rows)
        for labels, name in LABELS.items()
        if (first := found.get((network, labels, "wrist_relative_mpjpe_mm")))
    ]
    return Grid("egocentric hands (95 % intervals)", ["network", "labels", *_COLUMNS.values(), "n"], lines)
