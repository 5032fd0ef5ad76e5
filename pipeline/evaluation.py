"""What a run says about its annotation where the truth is known: by sequence, over all of them, and between methods."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.metrics.annotation import TABLE, Resampling, evaluate_overall
from assemblyhands_core.metrics.comparison import compare_methods
from pipeline.config import RunConfig
from pipeline.grids import Grid, rich_table
from pipeline.manifests import select_rows
from pipeline.terminal import say
from stages import evaluate
from stages.triangulate_ego import SOURCE as EGO_ONLY

METRIC_NAMES: Final = {
    "mpjpe_mm": "MPJPE (mm)",
    "pck_auc": "PCK-AUC (%)",
    "pck_auc_found": "PCK-AUC of found (%)",
    "coverage": "coverage (%)",
    "own": "own (%)",
}
"""What readers call the metrics of a table."""
_COMPARED: Final = {
    "mpjpe_mm_ratio": "MPJPE, ratio",
    "mpjpe_mm_common_ratio": "MPJPE of joints that both found, ratio",
    "pck_auc_difference": "PCK-AUC, difference",
}

POOLED: Final = "all"
"""What stands for the sequence in figures over several."""

_HEADSET_ALONE: Final = ", headset alone"
_SUFFIXES: Final = {"evaluation_ego_only_manual": ", people's crops"}
"""What is added to the names of a node's methods, since another node has methods of the same names."""

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
    """Return the sequences by kind: people that networks were trained on and other rigs are figures of their own.

    So is what was found from the headset alone, which not every recording has.
    """
    by_kind: dict[str, dict[str, pa.Table]] = defaultdict(dict)
    for name, table in errors.items():
        by_kind[kinds.get(name, "")][name] = table
    return [
        _pool(f"{POOLED if len(by_kind) == 1 else f'{POOLED} {kind}'.strip()}{family}", tables)
        for kind, of_kind in by_kind.items()
        for family, tables in _families(of_kind).items()
    ]


def _families(errors: Mapping[str, pa.Table]) -> dict[str, dict[str, pa.Table]]:
    """Return the errors by what methods saw: everything, or the headset's pictures alone."""
    found: dict[str, dict[str, pa.Table]] = {"": {}, _HEADSET_ALONE: {}}
    for name, table in errors.items():
        is_ego = pc.starts_with(table["method"], EGO_ONLY)
        for family, rows in (("", table.filter(pc.invert(is_ego))), (_HEADSET_ALONE, table.filter(is_ego))):
            if rows.num_rows:
                found[family][name] = rows
    return {family: tables for family, tables in found.items() if tables}


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
    rows = list(read_metrics(run))
    for name in errors:
        own = [row for row in rows if row["sequence_id"] == name]
        console.print(rich_table(method_grid(f"{name} against the simulator's truth", own)))
    for pool in pools(errors, kinds):
        _print_pooled(console, pool, settings.resampling)


def _print_pooled(console: Console, pool: Pool, resampling: Resampling) -> None:
    """Print figures over several sequences, and of methods against one another."""
    for name in pool.left_out:
        say(console, f"{name} is not in the figures over {pool.name} sequences: not all methods were evaluated there")
    if not pool.errors:
        return
    whole, title = pa.concat_tables(pool.errors), f"{pool.name}: {len(pool.errors)} sequences"
    if len(pool.errors) > 1:
        rows = [cell._asdict() for cell in evaluate_overall(whole, resampling)]
        console.print(rich_table(method_grid(f"{title} together against the simulator's truth", rows)))
    if len(set(whole["method"].to_pylist())) > 1:
        rows = [cell._asdict() for cell in compare_methods(whole, resampling)]
        console.print(rich_table(pair_grid(f"{title}, methods in pairs against the simulator's truth", rows)))


def read_errors(run: Path) -> dict[str, pa.Table]:
    """Return the errors of all methods by sequence."""
    tables: dict[str, list[pa.Table]] = defaultdict(list)
    for path in sorted(run.glob("evaluation_*/errors/*.parquet")):
        table = pq.read_table(path.resolve()).replace_schema_metadata(None)
        named = pc.binary_join_element_wise(table["method"], _suffix(path), "")
        tables[path.stem].append(table.set_column(table.schema.get_field_index("method"), "method", named))
    return {name: pa.concat_tables(of_name) for name, of_name in tables.items()}


def read_metrics(run: Path) -> Iterator[dict[str, Any]]:
    """Yield the figures of every sequence, methods named as `read_errors` does."""
    for path in sorted(run.glob("evaluation_*/metrics/*.parquet")):
        for row in pq.read_table(path.resolve()).to_pylist():
            yield row | {"row": row["row"] + _suffix(path)}


def _suffix(path: Path) -> str:
    return _SUFFIXES.get(path.parents[1].name, "")


def method_grid(title: str, rows: Rows) -> Grid:
    """Return the overall figures of methods with their 95 % intervals, and how many joints they are of.

    Args:
        title: What they are of.
        rows: Lines of evaluations, as the table `EVALUATION` has them; those of groups are left out.
    """
    return _grid(title, METRIC_NAMES, rows)


def pair_grid(title: str, rows: Rows) -> Grid:
    """Return how methods compare with one another, otherwise as `method_grid`."""
    return _grid(title, _COMPARED, rows)


def _grid(title: str, columns: Mapping[str, str], rows: Rows) -> Grid:
    by_method: dict[str, dict[str, Mapping[str, Any]]] = defaultdict(dict)
    for row in rows:
        if row["table"].removesuffix("_comparison") == TABLE:
            by_method[row["row"]][row["metric"]] = row
    cells = [
        [method, *(_figure(metrics[name]) for name in columns), str(metrics[next(iter(columns))]["n"])]
        for method, metrics in by_method.items()
        if columns.keys() <= metrics.keys()
    ]
    return Grid(f"{title} (95 % intervals)", ["method", *columns.values(), "n"], cells)


def _figure(row: Mapping[str, Any]) -> str:
    value, low, high = row["value"], row["low"], row["high"]
    interval = "" if low != low or low == high else f" ({low:.2f} to {high:.2f})"
    return f"{value:.2f}{interval}"
