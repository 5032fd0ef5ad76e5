"""Clean up the course of points over time: strays are damped, short gaps filled.

Each course is the minimiser of Σ w |y - z|² + λ Σ |Δ³z|² over its samples y (Whittaker 1923, Eilers 2003), so
that steady and evenly accelerated motion stay exactly as they are. The weights w are found from the course itself
by reweighting, absolute deviations first (they have one minimum, whatever the strays), then Tukey's biweight.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Int64

from assemblyhands_core.geometry.interpolation import fill_gaps

# Measured on hands of the studio at work with 1.5 to 4 mm of noise, 2 % strays and gaps up to 5 frames: known joints
# come out alike from local parabolas (LOESS), second and third differences; of filled ones 1 % are off by more than
# 60, 24 to 42 and 20 mm.
_THIRD_DIFFERENCE: Final = np.array([-1.0, 3.0, -3.0, 1.0])
_ORDER: Final = len(_THIRD_DIFFERENCE) - 1

_NUM_ABSOLUTE, _NUM_BIWEIGHT = 5, 3
_NEIGHBOURS: Final = 7  # frames on either side from which the spread at a frame is known
_MEDIAN_LENGTH: Final = 1.538  # of normal noise in three dimensions, in standard deviations along one
_MIN_SD_MM: Final = 0.1
_ALLOWED_BENDS: Final = 2.0  # second differences by which samples of a quick turn leave their course: no strays
_NO_WEIGHT: Final = 1e-6  # keeps courses determined that are known at one or two frames


@dataclass(frozen=True)
class SmoothingRule:
    """How much is smoothed.

    Attributes:
        max_gap_frames: Longest gap that is filled; nothing is smoothed across longer ones.
        cutoff_period_frames: A swing of this period keeps half of its size, slower ones all, quicker ones nothing.
        max_deviation_sd: Samples farther than that from the course do not count at all, in robust standard deviations.
    """

    max_gap_frames: int
    cutoff_period_frames: float
    max_deviation_sd: float


def smooth(
    points_mm: Float[np.ndarray, "instant track 3"], frame: Int[np.ndarray, " instant"], rule: SmoothingRule
) -> tuple[Float64[np.ndarray, "instant track 3"], Bool[np.ndarray, "instant track"]]:
    """Smooth the course of each point over time, on its own.

    Args:
        points_mm: In a frame that does not move; NaN where missing.
        frame: Number of each instant, ascending; what is between is missing and cannot be filled.
        rule: How much.

    Returns:
        The points, NaN where they stay missing, and which of them fill a gap.

    Raises:
        ValueError: Frames do not ascend.
    """
    if (np.diff(frame) <= 0).any():
        raise ValueError("frames repeat or do not ascend; sort the rows and give each instant once.")
    if not len(frame):
        return points_mm.astype(np.float64), np.zeros(points_mm.shape[:2], dtype=bool)
    row = _rows(frame, rule.max_gap_frames)
    dense = np.full((int(row[-1]) + 1, *points_mm.shape[1:]), np.nan)
    dense[row] = points_mm
    course, is_filled = _smooth_dense(dense, rule)
    return course[row], is_filled[row]


def _smooth_dense(
    points_mm: Float64[np.ndarray, "frame track 3"], rule: SmoothingRule
) -> tuple[Float64[np.ndarray, "frame track 3"], Bool[np.ndarray, "frame track"]]:
    """Like `smooth`, over consecutive frames."""
    is_sample = np.isfinite(points_mm).all(axis=-1)
    samples, is_filled = fill_gaps(np.where(is_sample[..., None], points_mm, np.nan), rule.max_gap_frames)
    is_known = is_sample | is_filled
    samples = np.where(is_known[..., None], samples, 0.0)
    weight = is_sample.astype(np.float64)
    for step in range(_NUM_ABSOLUTE + _NUM_BIWEIGHT):
        course = _course(samples, weight, is_known, rule.cutoff_period_frames)
        deviation = np.where(is_sample, np.linalg.norm(samples - course, axis=-1), np.nan)
        spread = _spread_mm(deviation)
        if step < _NUM_ABSOLUTE:
            weight = spread / np.fmax(deviation, spread)
        else:
            limit = rule.max_deviation_sd * spread + _ALLOWED_BENDS * _bend_mm(course, is_known)
            weight = np.maximum(1.0 - (np.nan_to_num(deviation) / limit) ** 2, 0.0) ** 2
        weight = np.where(is_sample, weight, 0.0)
    course = _course(samples, weight, is_known, rule.cutoff_period_frames)
    return np.where(is_known[..., None], course, np.nan), is_filled


def _rows(frame: Int[np.ndarray, " instant"], max_gap: int) -> Int64[np.ndarray, " instant"]:
    """Return where each instant stands among consecutive frames, of which very long gaps need not all be there."""
    steps = np.minimum(np.diff(frame, prepend=frame[:1]), max_gap + 2)
    return np.asarray(np.cumsum(steps), dtype=np.int64)


def _course(
    samples: Float64[np.ndarray, "frame track 3"],
    weight: Float64[np.ndarray, "frame track"],
    is_known: Bool[np.ndarray, "frame track"],
    cutoff_period: float,
) -> Float64[np.ndarray, "frame track 3"]:
    """Return the minimiser for given weights; meaningless where nothing is known."""
    from scipy.linalg import solveh_banded  # its import takes longer than all of ours

    penalty = (2.0 * np.sin(np.pi / cutoff_period)) ** (-2 * _ORDER)
    weight = np.where(is_known, np.maximum(weight, _NO_WEIGHT), 1.0)
    course = np.empty_like(samples)
    for track in range(samples.shape[1]):
        bands = _penalty_bands(is_known[:, track], penalty)
        bands[-1] += weight[:, track]
        course[:, track] = solveh_banded(bands, weight[:, track, None] * samples[:, track], check_finite=False)
    return course


def _penalty_bands(is_known: Bool[np.ndarray, " frame"], penalty: float) -> Float64[np.ndarray, "4 frame"]:
    """Return the upper diagonals of λ DᵀD, the main one last; D takes differences where all their frames are known."""
    bands = np.zeros((_ORDER + 1, len(is_known)))
    count = max(len(is_known) - _ORDER, 0)
    is_inside = np.all([is_known[first : first + count] for first in range(_ORDER + 1)], axis=0)
    for first in range(_ORDER + 1):
        for second in range(first, _ORDER + 1):
            product = penalty * _THIRD_DIFFERENCE[first] * _THIRD_DIFFERENCE[second]
            bands[_ORDER - (second - first), second : second + count] += product * is_inside
    return bands


def _spread_mm(deviation_mm: Float64[np.ndarray, "frame track"]) -> Float64[np.ndarray, "frame track"]:
    """Return the noise along an axis at each frame: that of the whole track, more where it is restless around there."""
    padded = np.pad(deviation_mm, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0)
    spread = np.maximum(_median_of_known(around), _median_of_known(deviation_mm.T))
    return np.asarray(np.maximum(spread / _MEDIAN_LENGTH, _MIN_SD_MM))


def _bend_mm(
    course: Float64[np.ndarray, "frame track 3"], is_known: Bool[np.ndarray, "frame track"]
) -> Float64[np.ndarray, "frame track"]:
    """Return the largest second difference at each frame and its two neighbours."""
    bend = np.zeros((len(course) + 2, course.shape[1]))
    is_inside = is_known[2:] & is_known[1:-1] & is_known[:-2]
    bend[2:-2] = np.where(is_inside, np.linalg.norm(np.diff(course, 2, axis=0), axis=-1), 0.0)
    return np.asarray(np.maximum(np.maximum(bend[:-2], bend[2:]), bend[1:-1]))


def _median_of_known(values: Float64[np.ndarray, "*batch value"]) -> Float64[np.ndarray, "*batch"]:
    """Return the (lower) median of what is finite along the last axis, 0 of nothing."""
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=-1)
    return np.asarray(np.where(count > 0, middle, 0.0)[..., 0])
