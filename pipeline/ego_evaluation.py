"""What a run says about its egocentric networks: each trained one against each kind of labels (paper, Table 4)."""

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from assemblyhands_core.data.store import load_table
from assemblyhands_core.metrics.egocentric import TABLE

_NODE: Final = "ego_evaluation"
_NETWORKS: Final = {"": "shipped", "_manual": "Train-M", "_automatic": "Train-A", "_both": "Train-M+A"}
_LABELS: Final = {"manual": "Eval-M", "automatic": "Eval-A", "both": "Eval-M+A"}
_COLUMNS: Final = {
    "wrist_relative_mpjpe_mm": "wrist-relative MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "identity_accuracy": "hand identity (%)",
    "coverage": "coverage (%)",
}


def print_egocentric(console: Console, run: Path) -> None:
    """Print the networks' figures, and write all of them to the run's `report/ego_cross.csv`; nothing without any."""
    rows = list(_rows(run))
    if not rows:
        return
    table = Table("network", "labels", *_COLUMNS.values(), "n", title="egocentric hands (95 % intervals)")
    for network in dict.fromkeys(row["network"] for row in rows):
        for labels, name in _LABELS.items():
            own = [row for row in rows if (row["network"], row["row"]) == (network, labels)]
            overall = {row["metric"]: row for row in own if (row["table"], row["group"]) == (TABLE, "")}
            if overall:
                count = overall["wrist_relative_mpjpe_mm"]["n"]
                table.add_row(network, name, *(_figure(overall[metric]) for metric in _COLUMNS), str(count))
    console.print(table)
    path = run / "report" / "ego_cross.csv"
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _rows(run: Path) -> Iterator[dict[str, Any]]:
    for suffix, network in _NETWORKS.items():
        node = run / f"{_NODE}{suffix}"
        if any((node / "metrics").glob("*.parquet")):
            yield from ({"network": network, **row} for row in load_table(node).to_pylist())


def _figure(row: Mapping[str, Any]) -> str:
    interval = "" if row["low"] != row["low"] else f" ({row['low']:.2f} to {row['high']:.2f})"
    return f"{row['value']:.2f}{interval}"
