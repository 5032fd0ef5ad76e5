"""What the truth says of an annotation: beside the paper's figures, round by round, and of every sequence."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import pyarrow as pa

from assemblyhands_core.metrics.annotation import evaluate_overall
from assemblyhands_core.viz.figures import method_label, pck_figure, round_figure
from pipeline.evaluation import POOLED, Pool, method_grid, pair_grid
from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.page import Block, Table, Text
from pipeline.html_report.pictures import from_figure
from pipeline.measured import RECORDINGS, NothingToShow
from pipeline.paper import annotation_of_rig
from stages.evaluate import UPPER_BOUND

UNJUDGED: Final = "this run was not held against the truth: it is known of synthetic recordings alone, with `evaluate`."
_NOTE: Final = "`own`: found in that round, not kept from an earlier one. `{bound}`: no annotation, but an upper bound."
_PAIRED: Final = "Paired: the same stretches of frames are drawn for both, so that what is hard for both cancels."
_PAPER_MM, _PAPER_PERCENT = "paper, real data (mm)", "paper, real data (%)"
_SEQUENCE_FIGURES: Final = {"coverage": "found (%)", "mpjpe_mm": "MPJPE of found (mm)", "pck_auc": "PCK-AUC (%)"}


def annotation(run: FinishedRun) -> Iterator[Block]:
    """Yield the methods beside the paper's, their PCK curves and errors from round to round."""
    for pool in judged_pools(run):
        yield from _of_pool(run, pool)


def judged_pools(run: FinishedRun) -> Sequence[Pool]:
    """Return the sequences that were held against the truth, by kind.

    Raises:
        NothingToShow: none was.
    """
    if not run.measured.pools:
        raise NothingToShow(UNJUDGED)
    return run.measured.pools


def pool_title(pool: Pool) -> str:
    """Return what kind of sequences they are, and how many."""
    kind = dict.fromkeys(
        pool.name.removeprefix(POOLED).strip(", ").split()
    )  # rig and split, once where they are the same word
    number = len(pool.errors)
    return f"{' '.join(kind) or POOLED}: {number} sequence{'s' if number != 1 else ''}"


def sequences(run: FinishedRun) -> Iterator[Block]:
    """Yield every sequence's figures before and after the rounds, so that odd ones stand out."""
    for pool in judged_pools(run):
        ends = run.measured.ends(pool)
        columns = [f"{name}: {method_label(method)}" for name in _SEQUENCE_FIGURES.values() for method in ends]
        rows = sorted(_sequence_row(run, errors, ends) for errors in pool.errors)
        yield Table(Grid(pool_title(pool), ["sequence", *columns, "joints found"], rows))


def bound_last(rows: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """Return rows of methods with the upper bound, which is none, at their end."""
    return sorted(rows, key=lambda row: UPPER_BOUND in row[0])


def _of_pool(run: FinishedRun, pool: Pool) -> Iterator[Block]:
    rows = [cell._asdict() for cell in run.measured.cells[pool.name]]
    title = pool_title(pool)
    rig = next((run.kinds.get(table["sequence_id"][0].as_py(), "") for table in pool.errors), "")
    paper = annotation_of_rig(rig.split(" ")[0])
    note = f"Paper: {paper.name}. {_NOTE.format(bound=UPPER_BOUND)}"
    yield Table(_beside_paper(method_grid(title, rows), paper.figures), note=note)
    pairs = pair_grid(f"{title}, methods in pairs", rows)
    if pairs.rows:
        yield Table(_readable(pairs), note=_PAIRED)
    try:
        figure = pck_figure(run.measured.curves(pool), RECORDINGS)
        yield from_figure(figure, f"PCK curves, {title}; the areas stand in the table above.")
        by_round, bound = run.measured.errors_by_round(pool)
        figure = round_figure(by_round, RECORDINGS, bound)
        yield from_figure(figure, f"Error by round, {title}, over all joints and by finger; as in the tables.")
    except NothingToShow as reason:
        yield Text(f"No figure of {title}: {reason}.")


def _beside_paper(grid: Grid, figures: Mapping[str, tuple[float, float]]) -> Grid:
    """Return methods with their coverage first, and each figure's counterpart beside it."""
    _, mpjpe, auc, auc_found, coverage, own, n = grid.columns
    columns = ["method", coverage, mpjpe, _PAPER_MM, auc, _PAPER_PERCENT, auc_found, own, n]
    rows = []
    for row in grid.rows:
        cells = dict(zip(grid.columns, row, strict=True))
        if row[0] in figures:
            mm, percent = figures[row[0]]
            cells |= {_PAPER_MM: f"{mm:.2f}", _PAPER_PERCENT: f"{percent:.1f}"}
        rows.append([cells.get(name, "–") for name in columns])
    return _readable(Grid(grid.title, columns, rows))


def _readable(grid: Grid) -> Grid:
    """Return a grid whose first column calls methods as figures do, pairs of them too, upper bounds last."""
    names = (" against ".join(map(method_label, row[0].split(" against "))) for row in grid.rows)
    return replace(grid, rows=bound_last([[name, *row[1:]] for name, row in zip(names, grid.rows, strict=True)]))


def _sequence_row(run: FinishedRun, errors: pa.Table, methods: Sequence[str]) -> list[str]:
    of_ends = errors.filter(pa.compute.is_in(errors["method"], value_set=pa.array(methods)))
    found = {(cell.row, cell.metric): cell for cell in evaluate_overall(of_ends, run.settings.resampling)}
    values = [found[method, name].value for name in _SEQUENCE_FIGURES for method in methods]
    num_found = str(found[methods[-1], "mpjpe_mm"].n)
    return [errors["sequence_id"][0].as_py(), *("–" if x != x else f"{x:.2f}" for x in values), num_found]
