"""The tables of annotation quality, made of the errors of every joint: the paper's Table 2 and supplement C.

One line for each method, group and metric, with a bootstrap interval over blocks of instants. ``mpjpe_mm`` is over the
joints that the method found and so goes with its coverage; ``pck_auc`` counts missing joints as wrong, as the paper
does; ``pck_auc_found`` is its other form, over the found joints alone. ``own`` is the share of the found joints that a
round found itself: the others are those of an earlier one, which it kept.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from assemblyhands_core.hands.joints import FINGERS, HANDS, JOINT_NAMES, NUM_JOINTS, WRIST
from assemblyhands_core.metrics.bootstrap import BlockSums, Interval, block_sums, draw_weights, mean_interval
from assemblyhands_core.metrics.error_rows import ErrorRows, align_methods
from assemblyhands_core.metrics.keypoints import MAX_MM, pck_auc_shares

TABLE: Final = "annotation"
_EVERY_JOINT: Final = tuple(range(NUM_JOINTS))


@dataclass(frozen=True)
class Resampling:
    """How intervals are drawn.

    Attributes:
        block_frames: Length of the stretches of a sequence that are drawn whole.
        num_resamples: How often all are drawn again.
        seed: Of the draws.
        level: Share of the draws within an interval.
    """

    block_frames: int
    num_resamples: int
    seed: int
    level: float = 0.95


class Cell(NamedTuple):
    """A line of an evaluation: see the table `EVALUATION`."""

    table: str
    group: str
    row: str
    metric: str
    value: float
    low: float
    high: float
    n: int
    coverage: float


class Group(NamedTuple):
    """Rows and joints that have figures of their own: a finger, a hand, a verb.

    Attributes:
        table: Of which it is a part.
        name: Its own; empty for all rows and joints.
        is_member: Which rows belong to it.
        joints: Which joints do.
    """

    table: str
    name: str
    is_member: Bool[np.ndarray, " row"]
    joints: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Quantity:
    """What a metric is the mean of: joints' amounts, and which joints count; the others' amount is 0."""

    amount: Float[np.ndarray, "row joint"]
    counts: Bool[np.ndarray, "row joint"]


def evaluate_annotation(errors: pa.Table, occlusion_bounds: tuple[float, float], resampling: Resampling) -> list[Cell]:
    """Return every method's figures over all joints, and by joint, finger, hand, verb and occlusion.

    Args:
        errors: Rows of the table `ERRORS`, of any number of sequences and methods.
        occlusion_bounds: Occlusion rates that part low from middle and middle from high; the same in every sequence,
            so that groups can be compared.
        resampling: How intervals are drawn.
    """
    cells: list[Cell] = []
    for method, rows in align_methods(errors, resampling.block_frames).items():
        cells += _cells(method, rows, groups_of(rows, occlusion_bounds), resampling)
    return cells


def evaluate_overall(errors: pa.Table, resampling: Resampling) -> list[Cell]:
    """Return every method's figures over all joints alone; arguments as for `evaluate_annotation`."""
    cells: list[Cell] = []
    for method, rows in align_methods(errors, resampling.block_frames).items():
        cells += _cells(method, rows, [_everything(rows)], resampling)
    return cells


def method_quantities(rows: ErrorRows) -> dict[str, Quantity]:
    """Return what each metric is the mean of: MPJPE in mm, shares in percent."""
    error_mm, labelled = rows.error_mm, rows.is_labelled
    found = labelled & np.isfinite(error_mm)
    has_wrist = labelled & np.isfinite(rows.wrist_relative_error_mm)
    area = 100 * pck_auc_shares(error_mm)
    return {
        "mpjpe_mm": masked(error_mm, found),
        "wrist_relative_mpjpe_mm": masked(rows.wrist_relative_error_mm, has_wrist),
        "pck_auc": masked(area, labelled),
        "pck_auc_found": masked(area, found),
        "pck_20mm": masked(100.0 * (error_mm <= MAX_MM), labelled),
        "coverage": masked(100.0 * found, labelled),
        "own": masked(100.0 * (found & rows.is_own[:, None]), found),
    }


def masked(amount: Float[np.ndarray, "row joint"], counts: Bool[np.ndarray, "row joint"]) -> Quantity:
    """Return the quantity that is the mean over those joints that count."""
    return Quantity(np.where(counts, amount, 0.0), counts)


def sums_over_all(quantity: Quantity, rows: ErrorRows) -> BlockSums:
    """Return a quantity's sums over the blocks of all rows and joints."""
    return sums_over(quantity, rows, _everything(rows))


def sums_over(quantity: Quantity, rows: ErrorRows, group: Group) -> BlockSums:
    """Return a quantity's sums over the blocks of a group's rows and joints."""
    joints = list(group.joints)
    of_group = (values[group.is_member][:, joints] for values in (quantity.amount, quantity.counts))
    total, count = (values.sum(axis=1, keepdims=True, dtype=np.float64) for values in of_group)
    return block_sums(total, count, rows.block[group.is_member], rows.num_blocks)


def groups_of(rows: ErrorRows, occlusion_bounds: tuple[float, float]) -> Iterator[Group]:
    """Yield the groups that figures are given of, all rows and joints first."""
    yield (everything := _everything(rows))
    everywhere = everything.is_member
    for joint, name in enumerate(JOINT_NAMES):
        yield Group(f"{TABLE}_by_joint", name, everywhere, (joint,))
    for finger, name in enumerate(FINGERS):
        yield Group(f"{TABLE}_by_finger", name, everywhere, tuple(range(4 * finger, 4 * finger + 4)))
    yield Group(f"{TABLE}_by_finger", JOINT_NAMES[WRIST], everywhere, (WRIST,))
    for hand in HANDS:
        yield Group(f"{TABLE}_by_hand", hand, rows.hand == hand, _EVERY_JOINT)
    for verb in np.unique(rows.verb.astype(str)):
        yield Group(f"{TABLE}_by_verb", str(verb) or "(between actions)", rows.verb == verb, _EVERY_JOINT)
    low, high = occlusion_bounds
    rate = rows.occlusion_rate
    for name, is_member in (
        (f"low (< {low:g})", rate < low),
        (f"middle ({low:g} to {high:g})", (rate >= low) & (rate < high)),
        (f"high (>= {high:g})", rate >= high),
    ):
        yield Group(f"{TABLE}_by_occlusion", name, is_member, _EVERY_JOINT)


def make_cell(names: tuple[str, str, str, str], interval: Interval, sums: BlockSums, coverage: float) -> Cell:
    """Return the line of a single estimate."""
    value, low, high = (float(values[0]) for values in (interval.value, interval.low, interval.high))
    return Cell(*names, value, low, high, int(sums.count.sum()), coverage)


def _cells(method: str, rows: ErrorRows, groups: Iterable[Group], resampling: Resampling) -> Iterator[Cell]:
    weights = draw_weights(rows.num_blocks, resampling.num_resamples, resampling.seed)
    quantities = method_quantities(rows)
    for group in groups:
        sums = {metric: sums_over(quantity, rows, group) for metric, quantity in quantities.items()}
        coverage = float(sums["coverage"].mean()[0])
        for metric, of_metric in sums.items():
            interval = mean_interval(of_metric, weights, resampling.level)
            yield make_cell((group.table, group.name, method, metric), interval, of_metric, coverage)


def _everything(rows: ErrorRows) -> Group:
    return Group(TABLE, "", np.ones(len(rows.frame), dtype=bool), _EVERY_JOINT)
