"""What a run says about its egocentric networks: each trained one against each kind of labels (paper, Table 4)."""

from pathlib import Path
from typing import Final

from rich.console import Console
from rich.table import Table

from assemblyhands_core.metrics.egocentric import TABLE
from pipeline.set_tables import figure_with_interval, labelled_rows, write_rows

_NETWORKS: Final = {
    "ego_evaluation": "shipped",
    "ego_evaluation_manual": "Train-M",
    "ego_evaluation_automatic": "Train-A",
    "ego_evaluation_both": "Train-M+A",
}
_LABELS: Final = {"manual": "Eval-M", "automatic": "Eval-A", "both": "Eval-M+A"}
_COLUMNS: Final = {
    "wrist_relative_mpjpe_mm": "wrist-relative MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "identity_accuracy": "hand identity (%)",
    "coverage": "coverage (%)",
}


def print_egocentric(console: Console, run: Path) -> None:
    """Print the networks' figures, and write all of them to the run's `report/ego_cross.csv`; nothing without any."""
    rows = list(labelled_rows(run, _NETWORKS, "network"))
    if not rows:
        return
    table = Table("network", "labels", *_COLUMNS.values(), "n", title="egocentric hands (95 % intervals)")
    for network in dict.fromkeys(row["network"] for row in rows):
        for labels, name in _LABELS.items():
            own = [row for row in rows if (row["network"], row["row"]) == (network, labels)]
            overall = {row["metric"]: row for row in own if (row["table"], row["group"]) == (TABLE, "")}
            if overall:
                count = overall["wrist_relative_mpjpe_mm"]["n"]
                table.add_row(
                    network, name, *(figure_with_interval(overall[metric]) for metric in _COLUMNS), str(count)
                )
    console.print(table)
    write_rows(run / "report" / "ego_cross.csv", rows)
