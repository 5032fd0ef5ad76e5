"""Figures of egocentric predictions (paper, Sec. 4, Table 4): wrist-relative errors of crops, and whose hands they are.

The wrist itself counts with error 0, as in the AssemblyHands toolkit (formats 2.8).
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Int

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS
from assemblyhands_core.metrics.annotation import Cell, Quantity, Resampling, make_cell, masked
from assemblyhands_core.metrics.bootstrap import BlockSums, block_sums, draw_weights, mean_interval
from assemblyhands_core.metrics.keypoints import coverage_percent, mean_of_joint_means, pck_auc_shares
from assemblyhands_core.metrics.run_differences import Difference, make_difference

TABLE: Final = "ego"
BOTH: Final = "both"
"""The row over the labels of people and our own together."""
BORDER_BOUNDS_PX: Final = (20.0, 80.0)


def evaluate_egocentric(errors: pa.Table, resampling: Resampling) -> list[Cell]:
    """Return the figures over all crops of each kind of labels, and by camera, hand and distance to the border.

    Args:
        errors: Rows of the table `EGO_ERRORS`, of any number of sequences.
        resampling: How intervals are drawn.
    """
    return [cell for labels, rows in by_labels(errors) for cell in _cells(labels, rows, resampling)]


def by_labels(errors: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """Yield the errors of each kind of labels and, where there are several, of all together."""
    kinds = sorted(set(errors["labels"].to_pylist()))
    for labels in kinds:
        yield labels, errors.filter(pa.compute.equal(errors["labels"], labels))
    if len(kinds) > 1:
        yield BOTH, errors


def egocentric_differences(first: pa.Table, second: pa.Table, resampling: Resampling) -> Iterator[Difference]:
    """Yield every figure of a network in two runs beside one another.

    Args:
        first, second: Rows of the table `EGO_ERRORS` of each run, of the same crops in the same order. Groups are those
            of the first.
        resampling: How intervals are drawn.
    """
    blocks = _blocks(first, resampling.block_frames)
    weights = draw_weights(blocks[1], resampling.num_resamples, resampling.seed)
    quantities = [_quantities(errors) for errors in (first, second)]
    for table, name, is_member in _groups(first):
        for metric in quantities[0]:
            one, other = (_sums(of_run[metric], is_member, *blocks) for of_run in quantities)
            yield make_difference((table, name, metric), one, other, weights, resampling.level)


def _cells(labels: str, errors: pa.Table, resampling: Resampling) -> Iterator[Cell]:
    blocks = _blocks(errors, resampling.block_frames)
    weights = draw_weights(blocks[1], resampling.num_resamples, resampling.seed)
    quantities = _quantities(errors)
    yield _toolkit_cell(labels, errors)
    for table, name, is_member in _groups(errors):
        sums = {metric: _sums(quantity, is_member, *blocks) for metric, quantity in quantities.items()}
        coverage = float(sums["coverage"].mean()[0])
        for metric, of_metric in sums.items():
            interval = mean_interval(of_metric, weights, resampling.level)
            yield make_cell((table, name, labels, metric), interval, of_metric, coverage)


def _sums(
    quantity: Quantity, is_member: Bool[np.ndarray, " row"], block: Int[np.ndarray, " row"], num_blocks: int
) -> BlockSums:
    """Return a quantity's sums over the blocks of some rows."""
    total, count = (values[is_member].sum(axis=1, keepdims=True) for values in (quantity.amount, quantity.counts))
    return block_sums(total, count, block[is_member], num_blocks)


def _toolkit_cell(labels: str, errors: pa.Table) -> Cell:
    """Return the mean over both hands' 42 joints of each one's mean error, as the AssemblyHands toolkit does it."""
    error_mm = to_numpy(errors["error_mm"]).astype(np.float64)
    both = np.full((len(error_mm), NUM_BOTH), np.nan)
    for index, hand in enumerate(HANDS):
        is_hand = to_numpy(errors["hand"]) == hand
        both[is_hand, NUM_JOINTS * index : NUM_JOINTS * (index + 1)] = error_mm[is_hand]
    labelled = to_numpy(errors["is_labelled"]).astype(bool)
    found = int((labelled & np.isfinite(error_mm)).sum())
    coverage = coverage_percent(error_mm, labelled)
    return Cell(TABLE, "", labels, "toolkit_mpjpe_mm", mean_of_joint_means(both), np.nan, np.nan, found, coverage)


def _quantities(errors: pa.Table) -> dict[str, Quantity]:
    error_mm = to_numpy(errors["error_mm"]).astype(np.float64)
    labelled = to_numpy(errors["is_labelled"]).astype(bool)
    found = labelled & np.isfinite(error_mm)
    is_right = to_numpy(errors["is_identity_right"]).astype(bool)[:, None]
    return {
        "wrist_relative_mpjpe_mm": masked(error_mm, found),
        "pck_auc": masked(100 * pck_auc_shares(error_mm), labelled),
        "coverage": masked(100.0 * found, labelled),
        "identity_accuracy": masked(100.0 * is_right, np.ones_like(is_right)),
    }


def _blocks(errors: pa.Table, block_frames: int) -> tuple[Int[np.ndarray, " row"], int]:
    """Return which stretch of which sequence each row belongs to, and how many there are; cameras share them."""
    _, sequence = np.unique(to_numpy(errors["sequence_id"]).astype(str), return_inverse=True)
    places = np.stack([sequence, to_numpy(errors["frame"]) // block_frames], axis=1)
    _, block = np.unique(places, axis=0, return_inverse=True)
    return block.ravel(), int(block.max(initial=-1)) + 1


def _groups(errors: pa.Table) -> Iterator[tuple[str, str, Bool[np.ndarray, " row"]]]:
    yield TABLE, "", np.ones(errors.num_rows, dtype=bool)
    for column, table in (("camera_id", "by_camera"), ("hand", "by_hand"), ("verb", "by_verb")):
        values = to_numpy(errors[column]).astype(str)
        for value in np.unique(values):
            yield f"{TABLE}_{table}", str(value) or "(not known)", values == value
    near, far = BORDER_BOUNDS_PX
    border_px = to_numpy(errors["border_px"])
    for name, is_member in (
        (f"near (< {near:g} px)", border_px < near),
        (f"middle ({near:g} to {far:g} px)", (border_px >= near) & (border_px < far)),
        (f"far (>= {far:g} px)", border_px >= far),
    ):
        yield f"{TABLE}_by_border", name, is_member
