"""Two runs beside one another: every figure that both have, with paired intervals where single errors are there."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from rich.console import Console

from assemblyhands_core.metrics.annotation import TABLE
from assemblyhands_core.metrics.comparison import differences
from assemblyhands_core.metrics.error_rows import align_methods
from assemblyhands_core.metrics.run_differences import shared_rows
from assemblyhands_core.viz.figures import Change, change_figure
from pipeline.config import RunConfig, UserError
from pipeline.difference_tables import Found, difference_grid, of_table, plain_number, tables_of
from pipeline.ego_evaluation import egocentric_rows
from pipeline.evaluation import pools, read_errors
from pipeline.finished import FinishedRun, open_run
from pipeline.grids import Grid, rich_table
from pipeline.html_report.annotation import pool_title
from pipeline.html_report.making import node_seconds, parameters
from pipeline.html_report.page import Block, Fold, Page, Table, sections
from pipeline.html_report.pictures import from_figure
from pipeline.html_report.writing import save
from pipeline.measured import RECORDINGS, NothingToShow
from pipeline.network_comparison import compare_networks
from pipeline.summary import quality_grids
from pipeline.terminal import say
from pipeline.verb_evaluation import verb_rows
from stages.evaluate import UPPER_BOUND

_HAND: Final = ("sequence_id", "frame", "hand")
_PRINTED: Final = ("coverage", "mpjpe_mm", "pck_auc")
_PRINTED_OF_NETWORKS: Final = (
    *("coverage", "wrist_relative_mpjpe_mm", "pck_auc", "identity_accuracy"),
    *("mean_verb_accuracy", "accuracy"),
)
_DRAWN: Final = "mpjpe_mm"


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
        printed = [d for d in of_table(found, TABLE) if d.metric in _PRINTED]
        console.print(rich_table(difference_grid(title, pair.names, printed)))
    networks = compare_networks(pair.first, pair.second)
    for title, found in networks.items():
        printed = [d for d in of_table(found, tables_of(found)[0]) if d.metric in _PRINTED_OF_NETWORKS]
        console.print(rich_table(difference_grid(title, pair.names, printed)))
    if not overall and not networks:
        say(console, "nothing was evaluated in both runs; the page has what else they share")
    folder = pair.first.folder / "report"
    folder.mkdir(exist_ok=True)
    save(console, _page(pair, overall, networks), folder / f"compare_{pair.first.name}_{pair.second.name}.html")
    return 0


def _open(config: RunConfig) -> _Pair:
    if not config.other:
        raise UserError("compare takes two runs: compare A B")
    first, second = open_run(config, config.run), open_run(config, config.other)
    shared = sorted(set(first.sequences) & set(second.sequences))
    if not shared:
        raise UserError(
            f"runs {first.name} and {second.name} have no sequence in common; compare runs on the same ones"
        )
    return _Pair(first, second, shared)


def _overall(pair: _Pair) -> Iterator[tuple[str, Found]]:
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
                shared = shared_rows(of_method[0], of_method[1], _HAND)
                rows = [align_methods(table, settings.block_frames)[method] for table in shared]
                bounds = settings.low_occlusion, settings.high_occlusion
                found[method] = list(differences(rows[0], rows[1], bounds, settings.resampling))
        if found:
            yield pool_title(pool), found


def _page(pair: _Pair, overall: Mapping[str, Found], networks: Mapping[str, Found]) -> Page:
    first, second = pair.names
    kind = ", all of them synthetic" if pair.first.is_synthetic and pair.second.is_synthetic else ""
    lead = (
        f"Each figure of run {first} beside that of run {second}, on {len(pair.shared)} sequences that both have{kind}."
    )
    parts = {
        "Annotation against the truth": partial(_annotation, pair, overall),
        "Egocentric hands and verbs": partial(_networks, pair, networks),
        "Quality without truth": partial(_quality, pair),
        "Time": partial(_times, pair),
        "What was different": partial(_settings, pair),
    }
    return Page(f"{first} against {second}", lead, sections(parts.items()))


def _annotation(pair: _Pair, overall: Mapping[str, Found]) -> Iterator[Block]:
    if not overall:
        raise NothingToShow("no method was evaluated in both runs.")
    first, second = pair.names
    for title, found in overall.items():
        yield Table(difference_grid(title, pair.names, of_table(found, TABLE)), note=_HOW.format(first, second))
        figure = change_figure(list(_changes(found)), f"MPJPE (mm): {first} − {second}", RECORDINGS)
        yield from_figure(figure, f"Differences of MPJPE, {title}; the same as in the tables.")
        yield from _folds(pair, title, found, [table for table in tables_of(found) if table != TABLE])


def _changes(found: Found) -> Iterator[Change]:
    """Yield the difference of each method, and by finger of the last one that is no upper bound."""
    last = [method for method in found if method != UPPER_BOUND or len(found) == 1][-1]
    for drawn, table in ((found, TABLE), ({last: found[last]}, f"{TABLE}_by_finger")):
        for d in of_table(drawn, table):
            if d.metric == _DRAWN and np.isfinite([d.value, d.low, d.high]).all():
                yield Change(d.group, d.value, d.low, d.high)


_HOW: Final = (
    "Positive: {} has more than {}. Paired intervals over stretches of frames: what is hard for both cancels. "
    "A run is called better where the whole interval says so. MPJPE is of the joints that each run found."
)


_HOW_NETWORKS: Final = (
    "Positive: {} has more than {}. Paired intervals over the same crops (by stretches of frames) or the same segments "
    "(by person or recording), as in the runs' own tables."
)


def _networks(pair: _Pair, networks: Mapping[str, Found]) -> Iterator[Block]:
    """Yield paired figures; and those over a whole set, which are comparable only if it is the same set."""
    for title, found in networks.items():
        overall, *others = tables_of(found)
        grid = difference_grid(title, pair.names, of_table(found, overall))
        yield Table(grid, note=_HOW_NETWORKS.format(*pair.names))
        yield from _folds(pair, title, found, others)
    if not pair.are_of_the_same:
        if not networks:
            raise NothingToShow("the runs are of different sequences, so that figures over all of them say nothing.")
        return
    figures = [_set_figures(run) for run in (pair.first, pair.second)]
    if not networks or figures[0].keys() & figures[1].keys():
        table = _plain_table("Figures that both have, without intervals", pair, *figures)
        yield Fold("All figures of the set", [table])


def _folds(pair: _Pair, title: str, found: Found, tables: Sequence[str]) -> Iterator[Block]:
    """Yield the tables by group, closed."""
    for table in tables:
        name = table.partition("_")[2].replace("_", " ")
        yield Fold(f"{name.capitalize()}; {title}", [Table(difference_grid(name, pair.names, of_table(found, table)))])


def _set_figures(run: FinishedRun) -> dict[str, float]:
    rows: list[Mapping[str, Any]] = [*egocentric_rows(run.folder), *verb_rows(run.folder)]
    names = ("network", "classifier", "table", "group", "row", "metric")
    return {", ".join(str(row[name]) for name in names if row.get(name)): row["value"] for row in rows}


def _quality(pair: _Pair) -> Iterator[Block]:
    found = [_quality_figures(run, pair.shared) for run in (pair.first, pair.second)]
    yield _plain_table("Figures without truth, of sequences that both have", pair, *found)


def _quality_figures(run: FinishedRun, sequences: Sequence[str]) -> dict[str, float]:
    return {
        f"{grid.title}, {grid.columns[0]}, {row[0]}, {metric}": float(cell)
        for grid in quality_grids(run.folder)
        if grid.title in sequences
        for row in grid.rows
        for metric, cell in zip(grid.columns[1:], row[1:], strict=True)
        if cell
    }


def _times(pair: _Pair) -> Iterator[Block]:
    """Yield the time of each node that has the same number of shards in both."""
    found = [
        {f"{name}, {len(seconds)} shards": sum(seconds) for name, seconds in node_seconds(run).items()}
        for run in (pair.first, pair.second)
    ]
    yield _plain_table("Work by node (s), when the results were made", pair, *found)


def _plain_table(title: str, pair: _Pair, first: Mapping[str, float], second: Mapping[str, float]) -> Table:
    rows = [
        [name, *(plain_number(value) for value in (first[name], second[name], first[name] - second[name]))]
        for name in first
        if name in second and np.isfinite([first[name], second[name]]).all()
    ]
    if not rows:
        raise NothingToShow("the runs have no such figures in common.")
    return Table(Grid(title, ["figure", *pair.names, f"{pair.names[0]} − {pair.names[1]}"], rows))


def _settings(pair: _Pair) -> Iterator[Block]:
    """Yield what was different in how they were made."""
    first, second = (dict(parameters(run)) for run in (pair.first, pair.second))
    names = dict.fromkeys([*first, *second])
    rows = [
        [name, first.get(name, "–"), second.get(name, "–")] for name in names if first.get(name) != second.get(name)
    ]
    yield Table(Grid("Command, versions and parameters", ["what", *pair.names], rows))
