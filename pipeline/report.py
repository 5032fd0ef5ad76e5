"""What runs that measure leave behind: a page to read, and of ``evaluate`` all figures in one file and pictures."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from rich.console import Console

from assemblyhands_core.data.evaluation_tables import EVALUATION
from assemblyhands_core.metrics.annotation import Cell
from assemblyhands_core.viz.figures import pck_figure, round_figure, save_figure
from assemblyhands_core.viz.round_sheet import draw_sheet, save_sheet
from pipeline.config import RunConfig
from pipeline.evaluation import POOLED, Pool, read_metrics
from pipeline.finished import FinishedRun, open_run
from pipeline.html_report.writing import write_page
from pipeline.measured import RECORDINGS, Measured, NothingToShow
from pipeline.round_crops import read_courses
from pipeline.terminal import say
from stages import evaluate, evaluate_ego, tabulate_ego, tabulate_verbs

_FILES_OF: Final = ("evaluate", "all")
_MEASURING: Final = (evaluate.STAGE, evaluate_ego.STAGE, tabulate_ego.STAGE, tabulate_verbs.STAGE)
"""Runs that were asked for one of these end with a page; of others, `python -m pipeline report` writes it."""


def write_report(console: Console, config: RunConfig, run: Path, kinds: Mapping[str, str]) -> None:
    """Write the report of a run that was asked to measure; say where its files are, or why one is not there.

    Args:
        console: Where that is said.
        config: Of the run.
        run: Its folder.
        kinds: Of sequences, see `evaluation.pools`; each kind has figures of its own.
    """
    asked = {config.dag.nodes[name].stage.name for name in config.wanted_nodes}
    if asked.isdisjoint(stage.name for stage in _MEASURING):
        return
    finished = FinishedRun(run, config, kinds)
    if config.target in _FILES_OF:
        _write_files(console, finished)
    write_page(console, finished)


def report_again(config: RunConfig, console: Console) -> int:
    """Write the page of a run that has ended; return the exit code."""
    write_page(console, open_run(config, config.run))
    return 0


def _write_files(console: Console, run: FinishedRun) -> None:
    measured, folder = run.measured, run.folder / "report"
    folder.mkdir(exist_ok=True)
    makers: dict[str, Callable[[Path], None]] = {
        "metrics.csv": lambda path: _write_metrics(path, run.folder, measured.cells),
    }
    for pool in measured.pools or [Pool(POOLED, (), ())]:
        suffix = pool.name.removeprefix(POOLED).replace(",", "").replace(" ", "_")
        makers |= {
            f"pck_curves{suffix}.png": partial(_draw_curves, measured, pool),
            f"error_by_round{suffix}.png": partial(_draw_rounds, measured, pool),
        }
    makers["crops_by_round.png"] = lambda path: _draw_crops(path, run)
    for name, make in makers.items():
        try:
            make(folder / name)
            line = f"report: {folder / name}"
        except NothingToShow as reason:
            line = f"report: without {name}: {reason}"
        say(console, line)


def _write_metrics(path: Path, run: Path, pooled: Mapping[str, Sequence[Cell]]) -> None:
    """Write a line for each figure: those of every sequence, and those of pools with their names for the sequence."""
    rows = list(read_metrics(run))
    if not rows:
        raise NothingToShow("nothing was evaluated")
    rows += [{"sequence_id": name, **cell._asdict()} for name, cells in pooled.items() for cell in cells]
    EVALUATION.from_rows(rows).to_pandas().to_csv(path, index=False)


def _draw_curves(measured: Measured, pool: Pool, path: Path) -> None:
    save_figure(pck_figure(measured.curves(pool), RECORDINGS), path)


def _draw_rounds(measured: Measured, pool: Pool, path: Path) -> None:
    by_round, bound = measured.errors_by_round(pool)
    save_figure(round_figure(by_round, RECORDINGS, bound), path)


def _draw_crops(path: Path, run: FinishedRun) -> None:
    courses = read_courses(run.folder, run.round_settings.window_rule())
    if not courses:
        raise NothingToShow("there is no hand with a stored crop that two rounds found")
    save_sheet(draw_sheet(courses, RECORDINGS), path)
