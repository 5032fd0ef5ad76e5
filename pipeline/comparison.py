"""Two runs beside one another: every figure that both have, with paired intervals where errors of joints are there."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from rich.console import Console

from assemblyhands_core.metrics.annotation import TABLE
from assemblyhands_core.metrics.comparison import Difference, differences
from assemblyhands_core.metrics.error_rows import align_methods
from assemblyhands_core.viz.figures import method_label
from pipeline.config import RunConfig, UserError
from pipeline.ego_evaluation import egocentric_rows
from pipeline.evaluation import pools, read_errors
from pipeline.finished import FinishedRun, open_run
from pipeline.grids import Grid, rich_table
from pipeline.html_report.making import parameters
from pipeline.html_report.page import Block, Fold, Page, Section, Table, Text
from pipeline.html_report.writing import save
from pipeline.summary import quality_grids
from pipeline.verb_evaluation import verb_rows

_HAND: Final = ("sequence_id", "frame", "hand")
_SURE, _UNSURE, _EQUAL = "{} is better", "no sure difference", "equal"
_NEUTRAL: Final = frozenset({"own"})
"""Metrics of which more is neither better nor worse."""


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two runs, and the sequences that both have."""

    first: FinishedRun
    second: FinishedRun
    shared: Sequence[str]

    @property
    def names(self) -> tuple[str, str]:
        return self.first.name, self.second.name

    @property
    def are_of_the_same(self) -> bool:
        return set(self.first.sequences) == set(self.second.sequences)


def compare_runs(config: RunConfig, console: Console) -> int:
    """Print how two runs compare, write the same and more as a page, and return the exit code.

    Raises:
        UserError: a run is not there, or they have no sequence in common.
    """
    pair = _open(config)
    overall = dict(_overall(pair))
    for title, found in overall.items():
        everything = {method: [d for d in of_method if d.table == TABLE] for method, of_method in found.items()}
        console.print(rich_table(_grid(title, pair, everything)))
    if not overall:
        console.print("no method was evaluated in both runs; the page has what else they share")
    folder = pair.first.folder / "report"
    folder.mkdir(exist_ok=True)
    save(console, _page(pair, overall), folder / f"compare_{pair.first.name}_{pair.second.name}.html")
    return 0


def _open(config: RunConfig) -> _Pair:
    if not config.other:
        raise UserError("compare takes two runs: run=NAME other=NAME")
    first, second = open_run(config, config.run), open_run(config, config.other)
    shared = sorted(set(first.sequences) & set(second.sequences))
    if not shared:
        raise UserError(
            f"runs {first.name} and {second.name} have no sequence in common; compare runs on the same ones"
        )
    return _Pair(first, second, shared)


def _overall(pair: _Pair) -> Iterator[tuple[str, dict[str, list[Difference]]]]:
    """Yield for each kind of sequences the differences of every method that both runs evaluated."""
    first, second = (read_errors(run.folder) for run in (pair.first, pair.second))
    both = {name: first[name] for name in first if name in second}
    settings = pair.first.settings
    for pool in pools(both, pair.first.kinds):
        names = [table["sequence_id"][0].as_py() for table in pool.errors]
        found = {}
        tables = pa.concat_tables(pool.errors), pa.concat_tables([second[name] for name in names])
        for method in pc.unique(tables[0]["method"]).to_pylist():
            of_method = [table.filter(pc.equal(table["method"], method)) for table in tables]
            if of_method[1].num_rows:
                rows = align_methods(_common(*of_method), settings.block_frames)
                bounds = settings.low_occlusion, settings.high_occlusion
                found[method] = list(differences(rows["first"], rows["second"], bounds, settings.resampling))
        if found:
            yield f"{pool.name}: {len(names)} sequences", found


def _common(first: pa.Table, second: pa.Table) -> pa.Table:
    """Return the errors at those hands and instants that both have, with the methods `first` and `second`."""
    keys = [list(zip(*(table[name].to_pylist() for name in _HAND), strict=True)) for table in (first, second)]
    both = set(keys[0]) & set(keys[1])
    kept = []
    for name, table, of_table in zip(("first", "second"), (first, second), keys, strict=True):
        rows = table.filter(pa.array([key in both for key in of_table], pa.bool_()))
        names = pa.array([name] * rows.num_rows, pa.string())
        kept.append(rows.set_column(rows.schema.get_field_index("method"), "method", names))
    return pa.concat_tables(kept)


def _grid(title: str, pair: _Pair, found: Mapping[str, Sequence[Difference]]) -> Grid:
    first, second = pair.names
    rows = [
        [
            f"{method_label(method)}, {d.group}" if d.group else method_label(method),
            d.metric,
            *(_number(value) for value in (d.first, d.second)),
            _with_interval(d),
            _verdict(d, pair),
            str(d.n),
        ]
        for method, of_method in found.items()
        for d in of_method
    ]
    columns = ["method", "metric", first, second, f"{first} − {second} (95 % interval)", "verdict", "n"]
    return Grid(title, columns, rows)


def _verdict(found: Difference, pair: _Pair) -> str:
    """Return which run is better; only where the whole interval says so."""
    if found.value == found.low == found.high == 0:
        return _EQUAL
    if not (found.low > 0 or found.high < 0):
        return _UNSURE
    if found.metric in _NEUTRAL:
        return "they differ"
    is_first_better = (found.value < 0) == found.metric.endswith("_mm")
    return _SURE.format(pair.names[0] if is_first_better else pair.names[1])


def _with_interval(found: Difference) -> str:
    bounds = "" if found.low != found.low else f" ({found.low:+.3f} to {found.high:+.3f})"
    return "–" if found.value != found.value else f"{found.value:.3f}{bounds}"


def _number(value: float) -> str:
    return "–" if value != value else f"{value:.3f}"


def _page(pair: _Pair, overall: Mapping[str, Mapping[str, Sequence[Difference]]]) -> Page:
    first, second = pair.names
    lead = f"Each figure of run {first} beside that of run {second}, on {len(pair.shared)} sequences that both have."
    sections = [_annotation(pair, overall), _networks(pair), _quality(pair), _settings(pair)]
    return Page(f"{first} against {second}", lead, sections)


def _annotation(pair: _Pair, overall: Mapping[str, Mapping[str, Sequence[Difference]]]) -> Section:
    blocks: list[Block] = []
    for title, found in overall.items():
        blocks.append(Table(_grid(title, pair, _of_table(found, TABLE)), note=_HOW.format(*pair.names)))
        tables = dict.fromkeys(d.table for of_method in found.values() for d in of_method if d.table != TABLE)
        for table in tables:
            name = table.removeprefix(f"{TABLE}_").replace("_", " ")
            grid = _grid(f"{name}: {title}", pair, _of_table(found, table))
            blocks.append(Fold(f"{name.capitalize()}: {title}", [Table(grid)]))
    return Section("Annotation against the truth", blocks or [Text("No method was evaluated in both runs.")])


_HOW: Final = (
    "Positive: {} has more than {}. Paired intervals over stretches of frames: what is hard for both cancels. "
    "A run is called better where the whole interval says so."
)


def _of_table(found: Mapping[str, Sequence[Difference]], table: str) -> dict[str, list[Difference]]:
    return {method: [d for d in of_method if d.table == table] for method, of_method in found.items()}


def _networks(pair: _Pair) -> Section:
    """Return figures over a whole set, which are comparable only if it is the same set."""
    title = "Egocentric hands and verbs"
    if not pair.are_of_the_same:
        return Section(
            title, [Text("The runs are of different sequences, so that figures over all of them say nothing.")]
        )
    found = [_set_figures(run) for run in (pair.first, pair.second)]
    grid = _plain_grid("Figures that both have; without paired intervals", pair, *found)
    return Section(title, [Table(grid)] if grid.rows else [Text("The runs have no such figures in common.")])


def _set_figures(run: FinishedRun) -> dict[str, float]:
    rows: list[Mapping[str, Any]] = [*egocentric_rows(run.folder), *verb_rows(run.folder)]
    names = ("network", "classifier", "table", "group", "row", "metric")
    return {", ".join(str(row[name]) for name in names if row.get(name)): row["value"] for row in rows}


def _quality(pair: _Pair) -> Section:
    found = [_quality_figures(run, pair.shared) for run in (pair.first, pair.second)]
    grid = _plain_grid("Figures without truth, of sequences that both have", pair, *found)
    sentence = Text("The runs have no quality tables in common.")
    return Section("Quality without truth", [Table(grid)] if grid.rows else [sentence])


def _quality_figures(run: FinishedRun, sequences: Sequence[str]) -> dict[str, float]:
    return {
        f"{grid.title}, {grid.columns[0]}, {row[0]}, {metric}": float(cell)
        for grid in quality_grids(run.folder)
        if grid.title in sequences
        for row in grid.rows
        for metric, cell in zip(grid.columns[1:], row[1:], strict=True)
        if cell
    }


def _plain_grid(title: str, pair: _Pair, first: Mapping[str, float], second: Mapping[str, float]) -> Grid:
    rows = [
        [name, *(_number(value) for value in (first[name], second[name], first[name] - second[name]))]
        for name in first
        if name in second and np.isfinite([first[name], second[name]]).all()
    ]
    return Grid(title, ["figure", *pair.names, f"{pair.names[0]} − {pair.names[1]}"], rows)


def _settings(pair: _Pair) -> Section:
    """Return what was different in how they were made."""
    first, second = (dict(parameters(run)) for run in (pair.first, pair.second))
    names = dict.fromkeys([*first, *second])
    rows = [
        [name, first.get(name, "–"), second.get(name, "–")] for name in names if first.get(name) != second.get(name)
    ]
    return Section("What was different", [Table(Grid("Command, versions and parameters", ["what", *pair.names], rows))])
