"""What a run says about its annotation where the truth is known: by sequence, over all of them, and between methods."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from assemblyhands_core.metrics.annotation import TABLE, Resampling, evaluate_overall
from assemblyhands_core.metrics.comparison import compare_methods
from pipeline.config import RunConfig
from pipeline.manifests import select_rows
from stages import evaluate

_COLUMNS: Final = {
    "mpjpe_mm": "MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "pck_auc_found": "PCK-AUC of found (%)",
    "coverage": "coverage (%)",
    "own": "own (%)",
}
_COMPARED: Final = {
    "mpjpe_mm_ratio": "MPJPE, ratio",
    "mpjpe_mm_common_ratio": "MPJPE of joints that both found, ratio",
    "pck_auc_difference": "PCK-AUC, difference",
}

POOLED: Final = "all"
"""What stands for the sequence in figures over several."""

Rows = Iterable[Mapping[str, Any]]


@dataclass(frozen=True)
class Pool:
    """Sequences of one kind, which figures may be pooled over.

    Attributes:
        name: What stands for the sequence in their figures.
        errors: Of every sequence that has all methods.
        left_out: The other sequences: with them, methods would be judged at different instants.
    """

    name: str
    errors: Sequence[pa.Table]
    left_out: Sequence[str]


def kinds_of_sequences(config: RunConfig) -> dict[str, str]:
    """Return rig and split of each sequence of a run, by its manifest; those of a rig of one's own are not there."""
    if config.rig.calibration is not None:
        return {}
    return {row["sequence_id"]: " ".join(filter(None, (row["rig"], row["split"]))) for row in select_rows(config)}


def pools(errors: Mapping[str, pa.Table], kinds: Mapping[str, str]) -> list[Pool]:
    """Return the sequences by kind: people that networks were trained on and other rigs are figures of their own."""
    by_kind: dict[str, list[str]] = defaultdict(list)
    for name in errors:
        by_kind[kinds.get(name, "")].append(name)
    return [
        _pool(POOLED if len(by_kind) == 1 else f"{POOLED} {kind}".strip(), {name: errors[name] for name in names})
        for kind, names in by_kind.items()
    ]


def _pool(name: str, errors: Mapping[str, pa.Table]) -> Pool:
    methods = {sequence: set(table["method"].to_pylist()) for sequence, table in errors.items()}
    every = set().union(*methods.values())
    whole = [sequence for sequence in errors if methods[sequence] == every]
    return Pool(name, [errors[sequence] for sequence in whole], [s for s in errors if s not in whole])


def print_evaluation(console: Console, config: RunConfig, run: Path, kinds: Mapping[str, str]) -> None:
    """Print a run's evaluations against the truth; nothing where it is not known."""
    settings = config.stages[evaluate.STAGE.name]
    assert isinstance(settings, evaluate.EvaluateConfig)
    errors = read_errors(run)
    for name in errors:
        paths = sorted(run.glob(f"evaluation_*/metrics/{name}.parquet"))
        rows = [row for path in paths for row in pq.read_table(path.resolve()).to_pylist()]
        _print(console, f"{name} against the simulator's truth", _COLUMNS, rows)
    for pool in pools(errors, kinds):
        _print_pooled(console, pool, settings.resampling)


def _print_pooled(console: Console, pool: Pool, resampling: Resampling) -> None:
    """Print figures over several sequences, and of methods against one another."""
    for name in pool.left_out:
        line = f"{name} is not in the figures over {pool.name} sequences: not all methods were evaluated there"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    if not pool.errors:
        return
    whole, title = pa.concat_tables(pool.errors), f"{pool.name}: {len(pool.errors)} sequences"
    if len(pool.errors) > 1:
        rows = [cell._asdict() for cell in evaluate_overall(whole, resampling)]
        _print(console, f"{title} together against the simulator's truth", _COLUMNS, rows)
    if len(set(whole["method"].to_pylist())) > 1:
        rows = [cell._asdict() for cell in compare_methods(whole, resampling)]
        _print(console, f"{title}, methods in pairs against the simulator's truth", _COMPARED, rows)


def read_errors(run: Path) -> dict[str, pa.Table]:
    """Return the errors of all methods by sequence."""
    tables: dict[str, list[pa.Table]] = defaultdict(list)
    for path in sorted(run.glob("evaluation_*/errors/*.parquet")):
        tables[path.stem].append(pq.read_table(path.resolve()).replace_schema_metadata(None))
    return {name: pa.concat_tables(of_name) for name, of_name in tables.items()}


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
