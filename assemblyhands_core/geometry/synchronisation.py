"""Estimate from moving keypoints whether a view agrees with the others: in time, and in where it looks.

A view that runs late and a view whose calibration is off both reproject badly. They differ in what is left once the
constant part is taken away: a calibration error is the same in all frames, a time shift changes with the motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.triangulation import triangulate

_MIN_POINTS = 30
_MIN_VIEWS = 3
_CLEAR_GAIN = 0.9


@dataclass(frozen=True, eq=False)
class Synchronisation:
    """How well each view fits the others when it is shifted in time.

    Attributes:
        shift: tried shifts in frames; with shift s the view shows at frame t what the others show at t - s.
        error_px: median reprojection error of the other views' 3D points, less its constant part; NaN where too little
            is seen.
        offset_px: the constant part at the best shift: how far right and down of where the others' points should be
            this view sees them. Large against the error: the view's calibration is off.
    """

    shift: Int[np.ndarray, " shift"]
    error_px: Float[np.ndarray, "view shift"]
    offset_px: Float[np.ndarray, "view 2"]

    @property
    def best_shift(self) -> Int[np.ndarray, " view"]:
        """Return the shift of least error; 0 where nothing can be said."""
        return np.where(np.isfinite(self.error_px).any(axis=1), self.shift[_argmin(self.error_px)], 0)

    @property
    def error_now_px(self) -> Float[np.ndarray, " view"]:
        """Return the error as recorded, unshifted."""
        return np.asarray(self.error_px[:, self.shift == 0][:, 0])

    @property
    def error_best_px(self) -> Float[np.ndarray, " view"]:
        """Return the error at the best shift."""
        return np.asarray(np.fmin.reduce(self.error_px, axis=1))


def estimate_synchronisation(
    keypoints_px: Float[np.ndarray, "frame view keypoint 2"],
    confidence: Float[np.ndarray, "frame view keypoint"],
    cameras: Sequence[Camera],
    *,
    max_shift: int,
    max_reprojection_px: float,
) -> Synchronisation:
    """Reproject what the other views see into each view, shifted in time, and see which shift fits best.

    A view that is late or looks elsewhere also spoils the points that the others are measured against. So the view that
    is off most is settled first, and the others are measured again with its delay and its offset taken out.

    Args:
        keypoints_px: one person's keypoints in raw pixels over consecutive frames; NaN = missing.
        confidence: 0 = missing.
        cameras: one for each view.
        max_shift: shifts from -max_shift to max_shift frames are tried.
        max_reprojection_px: inlier threshold of the triangulation.

    Returns:
        Errors by view and shift. Only motion that is not uniform tells: where nobody moves all shifts fit alike. With
        fewer than three views nothing can be said: the others have to agree on something first.
    """
    shift = np.arange(-max_shift, max_shift + 1)
    error, offset = np.full((len(cameras), len(shift)), np.nan), np.full((len(cameras), len(shift), 2), np.nan)
    as_recorded, seen, weight = np.full(len(cameras), np.nan), keypoints_px.copy(), confidence.copy()
    unsettled = list(range(len(cameras))) if len(cameras) >= _MIN_VIEWS else []
    while unsettled:
        for view in unsettled:
            expected_px = _seen_by_others(seen, weight, cameras, view, max_reprojection_px)
            as_recorded[view] = _median_length(seen[:, view] - expected_px)
            for i, s in enumerate(shift):
                offset[view, i], error[view, i] = _offset_and_spread(_shifted(seen[:, view], -int(s)) - expected_px)
        delay = np.where(_is_late(error, max_shift), _argmin(error), max_shift)
        gain = _CLEAR_GAIN * as_recorded - error[np.arange(len(cameras)), delay]
        if not (gain[unsettled] > 0).any():
            break
        worst = unsettled.pop(int(np.nanargmax(gain[unsettled])))
        by = -int(shift[delay[worst]])
        seen[:, worst] = _shifted(seen[:, worst], by) - offset[worst, delay[worst]]
        weight[:, worst] = _shifted(weight[:, worst], by)
    return Synchronisation(shift, error, offset[np.arange(len(cameras)), _argmin(error)])


def _is_late(error_px: Float[np.ndarray, "view shift"], unshifted: int) -> Bool[np.ndarray, " view"]:
    """Return whether a shift clearly lowers a view's error."""
    return np.asarray(np.fmin.reduce(error_px, axis=1) < _CLEAR_GAIN * error_px[:, unshifted])


def _argmin(error_px: Float[np.ndarray, "view shift"]) -> Int[np.ndarray, " view"]:
    """Return the shift of least error, the first where nothing is known."""
    return np.asarray(np.argmin(np.where(np.isnan(error_px), np.inf, error_px), axis=1))


def _offset_and_spread(
    difference_px: Float[np.ndarray, "frame keypoint 2"],
) -> tuple[Float[np.ndarray, "2"], float]:
    """Return the median of differences, and the median distance from it."""
    known = difference_px[np.isfinite(difference_px).all(axis=-1)]
    if len(known) < _MIN_POINTS:
        return np.full(2, np.nan), float("nan")
    offset = np.median(known, axis=0)
    return offset, _median_length(difference_px - offset)


def _median_length(difference_px: Float[np.ndarray, "frame keypoint 2"]) -> float:
    length = np.linalg.norm(difference_px, axis=-1)
    known = length[np.isfinite(length)]
    return float(np.median(known)) if len(known) >= _MIN_POINTS else float("nan")


def _seen_by_others(
    keypoints_px: Float[np.ndarray, "frame view keypoint 2"],
    confidence: Float[np.ndarray, "frame view keypoint"],
    cameras: Sequence[Camera],
    view: int,
    max_reprojection_px: float,
) -> Float[np.ndarray, "frame keypoint 2"]:
    """Return where the other views' 3D points fall in this view."""
    others = [v for v in range(len(cameras)) if v != view]
    pixels = keypoints_px[:, others].swapaxes(1, 2).reshape(-1, len(others), 2)
    weights = confidence[:, others].swapaxes(1, 2).reshape(-1, len(others))
    found = triangulate(pixels, [cameras[v] for v in others], weights, max_reprojection_px=max_reprojection_px)
    num_frames, _, num_keypoints = confidence.shape
    return np.asarray(cameras[view].project(found.points_world_mm)).reshape(num_frames, num_keypoints, 2)


def _shifted(values: Float[np.ndarray, " frame *rest"], by: int) -> Float[np.ndarray, " frame *rest"]:
    """Return values with frame t holding what was at t - by; NaN where there was nothing."""
    result = np.full_like(values, np.nan)
    length = len(values) - abs(by)
    if length > 0:
        result[max(by, 0) :][:length] = values[max(-by, 0) :][:length]
    return result
