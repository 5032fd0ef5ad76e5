"""The tables of nodes that stand for the whole set of sequences, read from a run and written beside its report."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from assemblyhands_core.data.store import load_table


def labelled_rows(run: Path, nodes: Mapping[str, str], label: str) -> Iterator[dict[str, Any]]:
    """Yield the metrics of each node that the run has, with what the node is called in a column of that name."""
    for node, name in nodes.items():
        folder = run / node
        if any((folder / "metrics").glob("*.parquet")):
            yield from ({label: name, **row} for row in load_table(folder).to_pylist())


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows of equal columns to a CSV file."""
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def figure_with_interval(row: Mapping[str, Any] | None, digits: int = 2) -> str:
    """Return a metric's value with its interval, where it has one; a dash where there is none."""
    if row is None or row["value"] != row["value"]:
        return "–"
    interval = "" if row["low"] != row["low"] else f" ({row['low']:.{digits}f} to {row['high']:.{digits}f})"
    return f"{row['value']:.{digits}f}{interval}"
