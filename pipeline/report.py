"""What ``evaluate`` leaves behind beside its tables: all figures in one file, and pictures of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import EVALUATION
from assemblyhands_core.data.hand_crops import HandKey, stored_hands
from assemblyhands_core.data.round_outcomes import displacement_mm
from assemblyhands_core.data.rounds import WindowRule, joints_or_nan, known_hands
from assemblyhands_core.metrics.annotation import TABLE, Cell, Resampling, evaluate_annotation
from assemblyhands_core.metrics.comparison import compare_methods
from assemblyhands_core.metrics.error_rows import align_methods
from assemblyhands_core.metrics.keypoints import MAX_MM, NUM_THRESHOLDS, pck_curve
from assemblyhands_core.viz.figures import PckCurve, RoundError, pck_figure, round_figure, save_figure
from assemblyhands_core.viz.round_sheet import HandCourse, HandRound, choose_hands, draw_sheet, follow_hand, save_sheet
from pipeline.config import RunConfig
from pipeline.evaluation import complete_sequences, read_errors
from stages import annotate_round, evaluate

POOLED: Final = "all"
"""What stands for the sequence in figures over all of them, as in ``seq=all``."""
_TARGET: Final = "evaluate"
_RECORDINGS: Final = "synthetic recordings"  # only the simulator knows the truth
_MAX_HANDS: Final = 4


def write_report(console: Console, config: RunConfig, run: Path) -> None:
    """Write the report of a run that was asked to evaluate, and print where its files are."""
    if config.target != _TARGET:
        return
    folder = run / "report"
    folder.mkdir(exist_ok=True)
    complete = complete_sequences(read_errors(run))
    cells = _pooled(pa.concat_tables(complete), config) if complete else []
    settings = _evaluation(config)
    absent = {
        "metrics.csv": _write_metrics(folder / "metrics.csv", run, cells),
        "pck_curves.png": _draw_curves(folder / "pck_curves.png", complete, cells, settings.resampling),
        "error_by_round.png": _draw_rounds(folder / "error_by_round.png", cells),
        "crops_by_round.png": _draw_crops(folder / "crops_by_round.png", run, config),
    }
    for name, reason in absent.items():
        line = f"left out of the report: {name}: {reason}" if reason else f"report: {folder / name}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _evaluation(config: RunConfig) -> evaluate.EvaluateConfig:
    return cast(evaluate.EvaluateConfig, config.stages[evaluate.STAGE.name])


def _pooled(errors: pa.Table, config: RunConfig) -> list[Cell]:
    """Return the figures over all sequences, and of methods against one another."""
    settings = _evaluation(config)
    bounds = settings.low_occlusion, settings.high_occlusion
    compared = compare_methods(errors, settings.resampling)
    return [*evaluate_annotation(errors, bounds, settings.resampling), *compared]
