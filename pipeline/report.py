"""What ``evaluate`` leaves behind beside its tables: all figures in one file, and pictures of them."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.data.catalog import EVALUATION
from assemblyhands_core.metrics.annotation import TABLE, Cell, evaluate_annotation
from assemblyhands_core.metrics.comparison import compare_methods
from assemblyhands_core.metrics.error_rows import align_methods
from assemblyhands_core.metrics.keypoints import MAX_MM, NUM_THRESHOLDS, pck_curve
from assemblyhands_core.viz.figures import PckCurve, RoundError, pck_figure, round_figure, save_figure
from assemblyhands_core.viz.round_sheet import draw_sheet, save_sheet
from pipeline.config import RunConfig
from pipeline.evaluation import POOLED, Pool, pools, read_errors
from pipeline.round_crops import read_courses
from stages import annotate_round, evaluate

_TARGET: Final = "evaluate"
_RECORDINGS: Final = "synthetic recordings"  # the truth that stages/evaluate.py reads is the simulator's
_GROUPED: Final = f"{TABLE}_by_finger"


class _NothingToShow(Exception):
    """Why a file of the report is not there."""


def write_report(console: Console, config: RunConfig, run: Path, kinds: Mapping[str, str]) -> None:
    """Write the report of a run that was asked to evaluate; say where its files are, or why one is not there.

    Args:
        console: Where that is said.
        config: Of the run.
        run: Its folder.
        kinds: Of sequences, see `evaluation.pools`; each kind has figures of its own.
    """
    if config.target != _TARGET:
        return
    folder = run / "report"
    folder.mkdir(exist_ok=True)
    settings = cast(evaluate.EvaluateConfig, config.stages[evaluate.STAGE.name])
    found = pools(read_errors(run), kinds)
    cells = {pool.name: _pooled(pool, settings) for pool in found}
    makers: dict[str, Callable[[Path], None]] = {
        "metrics.csv": lambda path: _write_metrics(path, run, cells),
    }
    for pool in found or [Pool(POOLED, (), ())]:
        suffix = pool.name.removeprefix(POOLED).replace(" ", "_")
        makers |= {
            f"pck_curves{suffix}.png": partial(_draw_curves, pool, cells.get(pool.name, ()), settings.block_frames),
            f"error_by_round{suffix}.png": partial(_draw_rounds, cells.get(pool.name, ()), _rounds(run)),
        }
    makers["crops_by_round.png"] = lambda path: _draw_crops(path, config, run)
    for name, make in makers.items():
        try:
            make(folder / name)
            line = f"report: {folder / name}"
        except _NothingToShow as reason:
            line = f"report: without {name}: {reason}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _rounds(run: Path) -> list[str]:
    """Return the methods of round 0 and those after it: what the errors of node ``evaluation_<round>`` are of."""
    methods: list[str] = []
    for number in itertools.takewhile(lambda k: (run / f"evaluation_{k}").is_dir(), itertools.count()):
        for path in sorted((run / f"evaluation_{number}" / "errors").glob("*.parquet")):
            methods += pq.read_table(path.resolve(), columns=["method"])["method"].unique().to_pylist()
    return list(dict.fromkeys(methods))


def _pooled(pool: Pool, settings: evaluate.EvaluateConfig) -> list[Cell]:
    """Return the figures over a pool's sequences, and of methods against one another."""
    if not pool.errors:
        return []
    errors = pa.concat_tables(pool.errors)
    bounds = settings.low_occlusion, settings.high_occlusion
    figures = evaluate_annotation(errors, bounds, settings.resampling)
    return [*figures, *compare_methods(errors, settings.resampling)]


def _write_metrics(path: Path, run: Path, pooled: Mapping[str, Sequence[Cell]]) -> None:
    """Write a line for each figure: those of every sequence, and those of pools with their names for the sequence."""
    tables = [pq.read_table(file.resolve()) for file in sorted(run.glob("evaluation_*/metrics/*.parquet"))]
    rows = [row for table in tables for row in table.to_pylist()]
    if not rows:
        raise _NothingToShow("nothing was evaluated")
    rows += [{"sequence_id": name, **cell._asdict()} for name, cells in pooled.items() for cell in cells]
    EVALUATION.from_rows(rows).to_pandas().to_csv(path, index=False)


def _draw_curves(pool: Pool, cells: Sequence[Cell], block_frames: int, path: Path) -> None:
    if not pool.errors:
        raise _NothingToShow("no sequence has all methods")
    errors = pa.concat_tables(pool.errors)
    thresholds_mm = np.linspace(0, MAX_MM, NUM_THRESHOLDS)
    areas = {cell.row: cell for cell in cells if cell.table == TABLE and cell.metric == "pck_auc"}
    curves = []
    for method, rows in align_methods(errors, block_frames).items():
        correct = pck_curve(rows.error_mm, rows.is_labelled, thresholds_mm)
        area = areas[method]
        curves.append(PckCurve(method, thresholds_mm, correct, area.value, area.coverage, area.n))
    curves.sort(key=lambda curve: curve.method == evaluate.UPPER_BOUND)  # no annotation: it comes last
    save_figure(pck_figure(curves, _RECORDINGS), path)


def _draw_rounds(cells: Sequence[Cell], rounds: Sequence[str], path: Path) -> None:
    drawn = [cell for cell in cells if cell.table in (TABLE, _GROUPED) and cell.metric == "mpjpe_mm"]
    errors = [RoundError(c.row, c.group, c.value, c.low, c.high, c.coverage, c.n) for c in drawn]
    by_round = [error for name in rounds for error in errors if error.method == name]
    if len({error.method for error in by_round}) < 2:
        raise _NothingToShow("there are no two rounds to compare")
    bound = next((error for error in errors if error.method == evaluate.UPPER_BOUND and not error.group), None)
    save_figure(round_figure(by_round, _RECORDINGS, bound), path)


def _draw_crops(path: Path, config: RunConfig, run: Path) -> None:
    settings = cast(annotate_round.AnnotateRoundConfig, config.stages[annotate_round.STAGE.name])
    courses = read_courses(run, settings.window_rule())
    if not courses:
        raise _NothingToShow("there is no hand with a stored crop that two rounds found")
    save_sheet(draw_sheet(courses, _RECORDINGS), path)
