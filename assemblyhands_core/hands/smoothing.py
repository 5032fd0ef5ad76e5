"""Clean up the course of a hand over time: strays damped, short gaps filled, bones of one length.

Each joint's course is the minimiser of Σ w |y - z|² + λ Σ |Δ³z|² over its samples y (Whittaker 1923, Eilers 2003), so
that steady and evenly accelerated motion stay exactly as they are. The weights w are found from the course itself
by reweighting, absolute deviations first (they have one minimum, whatever the strays), then Tukey's biweight.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Int64

from assemblyhands_core.geometry.interpolation import fill_gaps
from assemblyhands_core.hands.joints import BONES, NUM_JOINTS, WRIST
from assemblyhands_core.hands.kinematics import bone_lengths_mm

# Against local lines and parabolas (LOESS) and penalised second differences this had the smallest error on hands of the
# studio at work, 1.5 to 4 mm of noise, 2 % strays and gaps: the others cut the corners of quick movements.
_THIRD_DIFFERENCE: Final = np.array([-1.0, 3.0, -3.0, 1.0])
_ORDER: Final = len(_THIRD_DIFFERENCE) - 1

_NUM_ABSOLUTE, _NUM_BIWEIGHT = 5, 3
_NEIGHBOURS: Final = 7  # frames on either side from which the spread at a frame is known
_MEDIAN_LENGTH: Final = 1.538  # of normal noise in three dimensions, in standard deviations along one
_MIN_SD_MM: Final = 0.1
_NO_WEIGHT: Final = 1e-6  # keeps courses determined that are known at one or two frames

# Sharing out takes 14 % off the error in the same measurement, bones corrected from the wrist outwards alone add 3 %.
_NUM_SWEEPS: Final = 4
_WRIST_SHARE: Final = 1 / 6  # five bones pull at it


@dataclass(frozen=True)
class SmoothingRule:
    """How much is smoothed.

    Attributes:
        max_gap_frames: Longest gap that is filled; nothing is smoothed across longer ones.
        cutoff_period_frames: A swing of this period keeps half of its size, slower ones all of it, quicker ones nothing.
        max_deviation_sd: Samples farther than that from the course do not count at all, in robust standard deviations.
    """

    max_gap_frames: int
    cutoff_period_frames: float
    max_deviation_sd: float


def smooth_hand(
    joints_mm: Float[np.ndarray, "instant 21 3"], frame: Int[np.ndarray, " instant"], rule: SmoothingRule
) -> tuple[Float64[np.ndarray, "instant 21 3"], Bool[np.ndarray, "instant 21"]]:
    """Smooth one hand's joints over time and give its bones constant lengths.

    Args:
        joints_mm: In a frame that does not move; NaN where missing.
        frame: Number of each instant, ascending; what is between is missing and cannot be filled.
        rule: How much.

    Returns:
        The joints, NaN where they stay missing, and which of them fill a gap.

    Raises:
        ValueError: Frames do not ascend.
    """
    if (np.diff(frame) <= 0).any():
        raise ValueError("frames of a hand do not ascend or repeat; sort its rows and give each instant once.")
    if not len(frame):
        return joints_mm.astype(np.float64), np.zeros(joints_mm.shape[:2], dtype=bool)
    row = _rows(frame, rule.max_gap_frames)
    points = np.full((int(row[-1]) + 1, NUM_JOINTS, 3), np.nan)
    points[row] = joints_mm
    course, is_filled = smooth_courses(points, rule)
    return with_constant_bones(course[row]), is_filled[row]


def smooth_courses(
    points_mm: Float64[np.ndarray, "frame track 3"], rule: SmoothingRule
) -> tuple[Float64[np.ndarray, "frame track 3"], Bool[np.ndarray, "frame track"]]:
    """Smooth each track on its own; arguments and results like those of `smooth_hand`, over consecutive frames."""
    is_sample = np.isfinite(points_mm).all(axis=-1)
    samples, is_filled = fill_gaps(np.where(is_sample[..., None], points_mm, np.nan), rule.max_gap_frames)
    is_known = is_sample | is_filled
    samples = np.where(is_known[..., None], samples, 0.0)
    weight = is_sample.astype(np.float64)
    for step in range(_NUM_ABSOLUTE + _NUM_BIWEIGHT):
        course = _course(samples, weight, is_known, rule.cutoff_period_frames)
        deviation = np.where(is_sample, np.linalg.norm(samples - course, axis=-1), np.nan)
        limit = _spread_mm(deviation) * (1.0 if step < _NUM_ABSOLUTE else rule.max_deviation_sd)
        ratio = np.where(is_sample, deviation, np.inf) / limit
        weight = 1.0 / np.maximum(ratio, 1.0) if step < _NUM_ABSOLUTE else np.maximum(1.0 - ratio**2, 0.0) ** 2
    course = _course(samples, weight, is_known, rule.cutoff_period_frames)
    return np.where(is_known[..., None], course, np.nan), is_filled


def with_constant_bones(joints_mm: Float64[np.ndarray, "instant 21 3"]) -> Float64[np.ndarray, "instant 21 3"]:
    """Give each bone its median length over time, where both of its ends are known.

    A few sweeps in which both ends of a bone yield share the correction out over the hand (Jakobsen 2001); in the last
    one only the end away from the wrist moves, so that all lengths are exact.
    """
    lengths_mm = bone_lengths_mm(joints_mm)
    bones = [(bone, *BONES[bone], np.isfinite(lengths_mm[:, bone])) for bone in reversed(range(len(BONES)))]
    moved = joints_mm.copy()
    for is_last in (*[False] * _NUM_SWEEPS, True):
        for bone, child, parent, is_known in bones:
            if is_known.any():
                length_mm = float(np.median(lengths_mm[is_known, bone]))
                excess = _excess(moved[is_known, child] - moved[is_known, parent], length_mm)
                share = 0.0 if is_last else _WRIST_SHARE if parent == WRIST else 0.5
                moved[is_known, parent] += share * excess
                moved[is_known, child] -= (1.0 - share) * excess
    return moved


def _excess(bone_mm: Float64[np.ndarray, "instant 3"], length_mm: float) -> Float64[np.ndarray, "instant 3"]:
    """Return by what bones are longer than they should be; a bone without direction stays without."""
    found_mm = np.linalg.norm(bone_mm, axis=-1, keepdims=True)
    return bone_mm * (1.0 - length_mm / np.where(found_mm > 0, found_mm, 1.0))


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


def _median_of_known(values: Float64[np.ndarray, "*batch value"]) -> Float64[np.ndarray, "*batch"]:
    """Return the (lower) median of what is finite along the last axis, 0 of nothing."""
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=-1)
    return np.asarray(np.where(count > 0, middle, 0.0)[..., 0])
