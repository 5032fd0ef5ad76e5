"""What a sweep found: a line for each point, as a table, a CSV file and a picture."""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.metrics import egocentric, verbs
from assemblyhands_core.metrics.annotation import TABLE
from assemblyhands_core.viz.figures import save_figure
from assemblyhands_core.viz.sweep_figure import SweptValue, sweep_figure
from pipeline.config import RunConfig, UserError
from pipeline.ego_evaluation import egocentric_rows
from pipeline.finished import FinishedRun, open_run
from pipeline.grids import Grid, rich_table
from pipeline.round_crops import round_nodes
from pipeline.terminal import say
from pipeline.verb_evaluation import verb_rows
from stages.measure_quality import ALL_JOINTS, REPROJECTION

_ANNOTATION: Final = {"mpjpe_mm": "MPJPE (mm)", "pck_auc": "PCK-AUC (%)", "coverage": "coverage (%)"}
_MAX_DRAWN: Final = 2  # parameters that one picture can show


@dataclass(frozen=True)
class Point:
    """A point of a sweep.

    Attributes:
        overrides: What was asked for, as on the command line, also what all points share.
        config: Of its run.
    """

    overrides: Sequence[str]
    config: RunConfig

    @property
    def settings(self) -> Mapping[str, str]:
        """Return parameter → value."""
        return dict(override.split("=", 1) for override in self.overrides)


@dataclass(frozen=True)
class Figure:
    """What a run measured of itself: value, its interval (NaN without one), and how many it is the mean of."""

    value: float
    low: float = math.nan
    high: float = math.nan
    n: int = 0

    @property
    def text(self) -> str:
        """Return it as tables show it."""
        if math.isnan(self.value):
            return "–"
        return f"{self.value:.2f}" + ("" if math.isnan(self.low) else f" ({self.low:.2f} to {self.high:.2f})")


def write_sweep(console: Console, points: Sequence[Point], folder: Path) -> None:
    """Print what each point of a sweep measured; leave ``sweep.csv`` and ``sweep.png`` in a folder.

    Args:
        console: Where the table goes.
        points: Those that ran, in order; their runs are read.
        folder: Made if need be.
    """
    varied = varied_parameters(points)
    if not points or not varied:
        return
    found = [_figures(point) for point in points]
    names = list(dict.fromkeys(name for figures in found for name in figures))
    lines = [
        [*(point.settings.get(name, "") for name in varied), point.config.run]
        + [figures[name].text if name in figures else "–" for name in names]
        for point, figures in zip(points, found, strict=True)
    ]
    console.print(rich_table(Grid("sweep (95 % intervals)", [*varied, "run", *names], lines)))
    folder.mkdir(parents=True, exist_ok=True)
    _write_csv(folder / "sweep.csv", varied, points, found)
    say(console, f"sweep: {folder / 'sweep.csv'}")
    if names and len(varied) <= _MAX_DRAWN:
        values = [
            SweptValue(tuple(point.settings.get(name, "") for name in varied), f.value, f.low, f.high)
            for point, figures in zip(points, found, strict=True)
            if (f := figures.get(names[0])) is not None
        ]
        save_figure(sweep_figure(varied, names[0], values), folder / "sweep.png")
        say(console, f"sweep: {folder / 'sweep.png'}")


def varied_parameters(points: Sequence[Point]) -> list[str]:
    """Return the parameters whose values differ from point to point."""
    values: dict[str, set[str]] = {}
    for point in points:
        for name, value in point.settings.items():
            values.setdefault(name, set()).add(value)
    return [name for name, found in values.items() if len(found) > 1]


def _figures(point: Point) -> dict[str, Figure]:
    """Return what a point's run measured: against the truth where it is known, else how the views agree."""
    try:
        run = open_run(point.config, point.config.run)
    except UserError:  # it failed before there was anything
        return {}
    found = {**dict(_of_annotation(run)), **dict(_of_networks(run))}
    return found or dict(_of_quality(run))


def _of_annotation(run: FinishedRun) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of the last round, for each kind of sequences."""
    measured = run.measured
    for pool in measured.pools:
        kind = f", {pool.name}" if len(measured.pools) > 1 else ""
        cells = {(cell.row, cell.metric): cell for cell in measured.cells[pool.name] if cell.table == TABLE}
        for metric, name in _ANNOTATION.items():
            if measured.rounds and (cell := cells.get((measured.rounds[-1], metric))):
                yield name + kind, Figure(cell.value, cell.low, cell.high, cell.n)


def _of_networks(run: FinishedRun) -> Iterator[tuple[str, Figure]]:
    for row in egocentric_rows(run.folder):
        if (row["table"], row["group"], row["metric"]) == (egocentric.TABLE, "", "wrist_relative_mpjpe_mm"):
            name = f"SVEgoNet, {row['network']}, {row['row']} (mm)"
            yield name, Figure(row["value"], row["low"], row["high"], row["n"])
    for row in verb_rows(run.folder):
        if (row["table"], row["metric"]) == (verbs.TABLE, "mean_verb_accuracy"):
            name = f"verbs, {row['classifier']}, {row['row']} (%)"
            yield name, Figure(row["value"], row["low"], row["high"], row["n"])


def _of_quality(run: FinishedRun) -> Iterator[tuple[str, Figure]]:
    """Yield what is known without truth: how many joints the last round has, and how far off their pixels are."""
    for node in round_nodes(run.folder)[-1:]:
        counts = run.joint_reasons(node.name)
        if total := sum(counts.values()):
            yield "valid joints (%)", Figure(100 * counts.get("", 0) / total, n=total)
    tables = [pq.read_table(path.resolve()) for path in sorted((run.folder / "quality/quality").glob("*.parquet"))]
    medians = [
        (row["value"], row["n"])
        for table in tables
        for row in table.to_pylist()
        if row["table"] == REPROJECTION and row["row"] == ALL_JOINTS and row["n"]
    ]
    if n := sum(count for _, count in medians):
        mean_px = sum(median_px * count for median_px, count in medians) / n
        yield "reprojection of 2D + triangulation, cameras' medians (px)", Figure(mean_px, n=n)


def _write_csv(
    path: Path, varied: Sequence[str], points: Sequence[Point], found: Sequence[Mapping[str, Figure]]
) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*varied, "run", "figure", "value", "low", "high", "n"])
        for point, figures in zip(points, found, strict=True):
            settings = [point.settings.get(name, "") for name in varied]
            for name, figure in figures.items():
                row = [*settings, point.config.run, name, figure.value, figure.low, figure.high, figure.n]
                writer.writerow(row)
