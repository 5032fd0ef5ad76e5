"""What the truth says of a run's annotation, worked out once for all that is written of it."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.metrics.annotation import TABLE, Cell, evaluate_annotation
from assemblyhands_core.metrics.comparison import compare_methods
from assemblyhands_core.metrics.error_rows import align_methods
from assemblyhands_core.metrics.keypoints import MAX_MM, NUM_THRESHOLDS, pck_curve
from assemblyhands_core.viz.figures import PckCurve, RoundError
from pipeline.evaluation import Pool, pools, read_errors
from stages import evaluate

RECORDINGS: Final = "synthetic recordings"
"""What figures are of: the truth that stages/evaluate.py reads is the simulator's."""
_GROUPED: Final = f"{TABLE}_by_finger"


class NothingToShow(Exception):
    """Why a part of a report is not there."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A run's annotation, held against the truth.

    Attributes:
        pools: Sequences by kind, each kind with figures of its own; none where nothing was evaluated.
        cells: Figures over each pool's sequences, and of methods against one another, by the pool's name.
        rounds: The methods of round 0 and those after it.
        block_frames: Length of the stretches that intervals draw whole.
    """

    pools: Sequence[Pool]
    cells: Mapping[str, Sequence[Cell]]
    rounds: Sequence[str]
    block_frames: int

    def ends(self, pool: Pool) -> list[str]:
        """Return the first and the last round's method, or all methods of a pool that has none of rounds."""
        methods = [cell.row for cell in self.cells[pool.name] if cell.table == TABLE]
        rounds = [name for name in self.rounds if name in methods]
        return list(dict.fromkeys([rounds[0], rounds[-1]] if rounds else methods))

    def curves(self, pool: Pool) -> list[PckCurve]:
        """Return each method's PCK curve.

        Raises:
            NothingToShow: no sequence was evaluated with all methods.
        """
        if not pool.errors:
            raise NothingToShow("no sequence has all methods")
        thresholds_mm = np.linspace(0, MAX_MM, NUM_THRESHOLDS)
        areas = {c.row: c for c in self.cells[pool.name] if c.table == TABLE and c.metric == "pck_auc"}
        curves = []
        for method, rows in align_methods(pa.concat_tables(pool.errors), self.block_frames).items():
            correct = pck_curve(rows.error_mm, rows.is_labelled, thresholds_mm)
            area = areas[method]
            curves.append(PckCurve(method, thresholds_mm, correct, area.value, area.coverage, area.n))
        curves.sort(key=lambda curve: curve.method == evaluate.UPPER_BOUND)  # no annotation: it comes last
        return curves

    def errors_by_round(self, pool: Pool) -> tuple[list[RoundError], RoundError | None]:
        """Return the errors of the rounds, over all joints and by finger, and the upper bound's over all.

        Raises:
            NothingToShow: there are no two rounds.
        """
        cells = self.cells.get(pool.name, ())
        drawn = [cell for cell in cells if cell.table in (TABLE, _GROUPED) and cell.metric == "mpjpe_mm"]
        errors = [RoundError(c.row, c.group, c.value, c.low, c.high, c.coverage, c.n) for c in drawn]
        by_round = [error for name in self.rounds for error in errors if error.method == name]
        if len({error.method for error in by_round}) < 2:
            raise NothingToShow("there are no two rounds to compare")
        bound = (error for error in errors if error.method == evaluate.UPPER_BOUND and not error.group)
        return by_round, next(bound, None)


def measure(run: Path, kinds: Mapping[str, str], settings: evaluate.EvaluateConfig) -> Measured:
    """Work the figures out.

    Args:
        run: The run's folder.
        kinds: Of sequences, see `evaluation.pools`.
        settings: How intervals are drawn, and what low and high occlusion are.
    """
    found = pools(read_errors(run), kinds)
    cells = {pool.name: _cells(pool, settings) for pool in found}
    return Measured(found, cells, _rounds(run), settings.block_frames)


def _cells(pool: Pool, settings: evaluate.EvaluateConfig) -> list[Cell]:
    if not pool.errors:
        return []
    errors = pa.concat_tables(pool.errors)
    figures = evaluate_annotation(errors, (settings.low_occlusion, settings.high_occlusion), settings.resampling)
    return [*figures, *compare_methods(errors, settings.resampling)]


def _rounds(run: Path) -> list[str]:
    """Return what the errors of node ``evaluation_<round>`` are of, round by round."""
    methods: list[str] = []
    for number in itertools.takewhile(lambda k: (run / f"evaluation_{k}").is_dir(), itertools.count()):
        for path in sorted((run / f"evaluation_{number}" / "errors").glob("*.parquet")):
            methods += pq.read_table(path.resolve(), columns=["method"])["method"].unique().to_pylist()
    return list(dict.fromkeys(methods))
