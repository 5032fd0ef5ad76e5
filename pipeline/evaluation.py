"""What a run says about its annotation where the truth is known: by sequence, over all of them, and between methods."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from assemblyhands_core.metrics.annotation import TABLE, Resampling, evaluate_overall
from assemblyhands_core.metrics.comparison import compare_methods
from pipeline.config import RunConfig
from stages import evaluate

_COLUMNS: Final = {
    "mpjpe_mm": "MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "pck_auc_found": "PCK-AUC of found (%)",
    "coverage": "coverage (%)",
}
_COMPARED: Final = {
    "mpjpe_mm_ratio": "MPJPE, ratio",
    "mpjpe_mm_common_ratio": "MPJPE of joints that both found, ratio",
    "pck_auc_difference": "PCK-AUC, difference",
}

Rows = Iterable[Mapping[str, Any]]


def print_evaluation(console: Console, config: RunConfig, run: Path) -> None:
    """Print a run's evaluations against the truth; nothing where it is not known."""
    settings = config.stages[evaluate.STAGE.name]
    assert isinstance(settings, evaluate.EvaluateConfig)
    errors = read_errors(run)
    for name in errors:
        paths = sorted(run.glob(f"evaluation_*/metrics/{name}.parquet"))
        rows = [row for path in paths for row in pq.read_table(path.resolve()).to_pylist()]
        _print(console, f"{name} against the simulator's truth", _COLUMNS, rows)
    if complete := complete_sequences(errors):
        _print_pooled(console, complete, settings.resampling)


def _print_pooled(console: Console, errors: Sequence[pa.Table], resampling: Resampling) -> None:
    """Print figures over several sequences, and of methods against one another."""
    whole = pa.concat_tables(errors)
    if len(errors) > 1:
        rows = [cell._asdict() for cell in evaluate_overall(whole, resampling)]
        _print(console, f"{len(errors)} sequences together against the simulator's truth", _COLUMNS, rows)
    if len(set(whole["method"].to_pylist())) > 1:
        rows = [cell._asdict() for cell in compare_methods(whole, resampling)]
        _print(console, "methods in pairs against the simulator's truth", _COMPARED, rows)


def read_errors(run: Path) -> dict[str, pa.Table]:
    """Return the errors of all methods by sequence."""
    tables: dict[str, list[pa.Table]] = defaultdict(list)
    for path in sorted(run.glob("evaluation_*/errors/*.parquet")):
        tables[path.stem].append(pq.read_table(path.resolve()).replace_schema_metadata(None))
    return {name: pa.concat_tables(of_name) for name, of_name in tables.items()}


def complete_sequences(errors: Mapping[str, pa.Table]) -> list[pa.Table]:
    """Return the sequences that have all methods: the others would make means over different instants."""
    methods = {name: set(table["method"].to_pylist()) for name, table in errors.items()}
    every = set().union(*methods.values())
    return [table for name, table in errors.items() if methods[name] == every]


def _print(console: Console, title: str, columns: Mapping[str, str], rows: Rows) -> None:
    """Print the overall figures with their 95 % intervals, and how many joints they are of."""
    table = Table("method", *columns.values(), "n", title=f"{title} (95 % intervals)", title_justify="left")
    by_method: dict[str, dict[str, Mapping[str, Any]]] = defaultdict(dict)
    for row in rows:
        if row["table"].removesuffix("_comparison") == TABLE:
            by_method[row["row"]][row["metric"]] = row
    for method, metrics in by_method.items():
        figures = [_figure(metrics[name]) for name in columns]
        table.add_row(method, *figures, str(metrics[next(iter(columns))]["n"]))
    console.print(table)


def _figure(row: Mapping[str, Any]) -> str:
    value, low, high = row["value"], row["low"], row["high"]
    interval = "" if low != low or low == high else f" ({low:.2f} to {high:.2f})"
    return f"{value:.2f}{interval}"
