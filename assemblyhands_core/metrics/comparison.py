"""Methods against one another, in pairs: by how much an annotation is better, and how sure that is."""

import itertools
from collections.abc import Iterator

import pyarrow as pa

from assemblyhands_core.metrics.annotation import (
    TABLE,
    Cell,
    Resampling,
    groups_of,
    make_cell,
    masked,
    method_quantities,
    sums_over,
    sums_over_all,
)
from assemblyhands_core.metrics.bootstrap import Weights, difference_interval, draw_weights, ratio_interval
from assemblyhands_core.metrics.error_rows import ErrorRows, align_methods
from assemblyhands_core.metrics.run_differences import Difference, make_difference


def compare_methods(errors: pa.Table, resampling: Resampling) -> list[Cell]:
    """Return how every method compares with each before it: ratios and differences, with paired intervals.

    MPJPE is compared twice: each method over what it found, as the paper's tables do, and (``_common``) over the joints
    that both found, which does not reward a method for giving up on hard joints. PCK-AUC counts missing as wrong.

    Args:
        errors: Rows of the table `ERRORS`; every method on the same hands and instants.
        resampling: How intervals are drawn.
    """
    methods = align_methods(errors, resampling.block_frames)
    cells: list[Cell] = []
    for before, after in itertools.combinations(methods, 2):
        weights = draw_weights(methods[after].num_blocks, resampling.num_resamples, resampling.seed)
        cells += _pair(f"{after} against {before}", methods[after], methods[before], weights, resampling.level)
    return cells


def differences(
    first: ErrorRows, second: ErrorRows, occlusion_bounds: tuple[float, float], resampling: Resampling
) -> Iterator[Difference]:
    """Yield every figure of a method in two runs beside one another.

    Args:
        first, second: The method's errors in each run, on the same hands and instants.
        occlusion_bounds: As for `evaluate_annotation`.
        resampling: How intervals are drawn.
    """
    weights = draw_weights(first.num_blocks, resampling.num_resamples, resampling.seed)
    quantities = [method_quantities(rows) for rows in (first, second)]
    for group in groups_of(first, occlusion_bounds):
        for metric in quantities[0]:
            one, other = (sums_over(of_run[metric], first, group) for of_run in quantities)
            yield make_difference((group.table, group.name, metric), one, other, weights, resampling.level)


def _pair(row: str, after: ErrorRows, before: ErrorRows, weights: Weights, level: float) -> Iterator[Cell]:
    quantities = [method_quantities(rows) for rows in (after, before)]
    both = quantities[0]["mpjpe_mm"].counts & quantities[1]["mpjpe_mm"].counts
    for of_method, rows in zip(quantities, (after, before), strict=True):
        of_method["mpjpe_mm_common"] = masked(rows.error_mm, both)
    coverage = float(sums_over_all(quantities[0]["coverage"], after).mean()[0])
    for metric in ("mpjpe_mm", "mpjpe_mm_common", "pck_auc"):
        first, second = (sums_over_all(of_method[metric], after) for of_method in quantities)
        names = f"{TABLE}_comparison", "", row
        difference = difference_interval(first, second, weights, level)
        yield make_cell((*names, f"{metric}_difference"), difference, first, coverage)
        if metric != "pck_auc":
            yield make_cell((*names, f"{metric}_ratio"), ratio_interval(first, second, weights, level), first, coverage)
