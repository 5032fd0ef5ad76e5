"""Triangulation of many points by any number of views at once.

Robust: two-view hypotheses scored in all views (`hypotheses`), then Gauss-Newton on the reprojection error with robust
weights (`refinement`). Plain: the linear DLT (Hartley & Zisserman, 12.2).
Nothing loops over points and nothing enumerates subsets of cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64, Int, Shaped

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.dlt import linear_points
from assemblyhands_core.geometry.hypotheses import best_hypotheses
from assemblyhands_core.geometry.reasons import Reason
from assemblyhands_core.geometry.refinement import depth_along_rays_mm, refine
from assemblyhands_core.geometry.sightlines import Sightlines, sightlines

Points = Float64[np.ndarray, "point 3"]
Pixels = Float64[np.ndarray, "point view 2"]
PerView = Float64[np.ndarray, "point view"]
Views = Bool[np.ndarray, "point view"]
Status = Shaped[np.ndarray, " point"]  # strings

_BLOCK_PIXELS = 1 << 16  # observations held in memory at once


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Points with the evidence for each.

    Attributes:
        points_world_mm: Robust: NaN unless the status is `ok`. Plain: NaN only with too few views.
        is_inlier: Views that agree with the point within the allowed distance.
        reprojection_px: Distance in raw pixels for every observed view, outliers too; NaN where there is no pixel, no
            point, or the point lies behind the camera or outside its field.
        status: Strings of `Reason`.
    """

    points_world_mm: Points
    is_inlier: Views
    reprojection_px: PerView
    status: Status

    @property
    def valid(self) -> Bool[np.ndarray, " point"]:
        """Tell which points have status `ok`."""
        return np.asarray(self.status == Reason.OK)

    @property
    def num_views(self) -> Int[np.ndarray, " point"]:
        """Count the inlier views."""
        return np.asarray(self.is_inlier.sum(axis=1))


def triangulate(
    pixels: Float[np.ndarray, "point view 2"],
    cameras: Sequence[Camera],
    confidence: Float[np.ndarray, "point view"] | None = None,
    robust: bool = True,
    *,
    max_reprojection_px: float = 10.0,
    min_views: int = 2,
    min_parallax_rad: float = 0.01,
) -> Triangulation:
    """Find points from their pixels in several views.

    Args:
        pixels: Raw (distorted) pixels, NaN = missing.
        cameras: One for each view, any mix of lenses.
        confidence: Factors on the pixel errors, 0 = do not use; by default 1. Not read without a pixel.
        robust: Reject outlying views. Otherwise the linear DLT over all usable views: each in normalised units without
            `confidence`, in pixel units (focal length times confidence) with it.
        max_reprojection_px: Largest distance of an inlier in raw pixels.
        min_views: Fewest usable views, and fewest inliers, of a point.
        min_parallax_rad: Smallest spread of the rays of a point.

    Returns:
        Points, inliers, residuals and a status for each point. Without `robust` no view can be left out, so a point is
        `ok` only when all its usable views are inliers.

    Raises:
        ValueError: The shapes do not fit together, or a confidence is negative or not finite.
    """
    if len(cameras) < 2 or min_views < 2:
        raise ValueError(f"Triangulation needs 2 views: got {len(cameras)} cameras and min_views={min_views}.")
    given = np.asarray(pixels, dtype=np.float64)
    weights = _checked_confidence(given, len(cameras), confidence)
    settings = _Settings(max_reprojection_px, min_views, min_parallax_rad, weighted=confidence is not None)
    solve = _triangulate_robustly if robust else _triangulate_linearly
    size = max(1, _BLOCK_PIXELS // len(cameras))
    blocks = [
        solve(given[begin : begin + size], cameras, weights[begin : begin + size], settings)
        for begin in range(0, max(len(given), 1), size)
    ]
    return Triangulation(
        np.concatenate([block.points_world_mm for block in blocks]),
        np.concatenate([block.is_inlier for block in blocks]),
        np.concatenate([block.reprojection_px for block in blocks]),
        np.concatenate([block.status for block in blocks]),
    )


@dataclass(frozen=True)
class _Settings:
    max_reprojection_px: float
    min_views: int
    min_parallax_rad: float
    weighted: bool


def _checked_confidence(
    pixels: Pixels, num_cameras: int, confidence: Float[np.ndarray, "point view"] | None
) -> PerView:
    if pixels.ndim != 3 or pixels.shape[1:] != (num_cameras, 2):
        raise ValueError(f"Pixels have shape {pixels.shape}: expected (points, {num_cameras} cameras, 2).")
    observed = np.asarray(np.isfinite(pixels).all(axis=-1))
    if confidence is None:
        return observed.astype(np.float64)
    weights = np.asarray(confidence, dtype=np.float64)
    if weights.shape != observed.shape:
        raise ValueError(f"Confidence has shape {weights.shape} and pixels {pixels.shape}: give one value per pixel.")
    wrong = observed & ~(np.isfinite(weights) & (weights >= 0))
    if wrong.any():
        point, view = np.argwhere(wrong)[0]
        raise ValueError(
            f"Confidence of point {point} in view {view} is {weights[point, view]}: give a number of at least 0."
        )
    return np.where(observed, weights, 0.0)


def _triangulate_robustly(
    pixels: Pixels, cameras: Sequence[Camera], confidence: PerView, settings: _Settings
) -> Triangulation:
    threshold = settings.max_reprojection_px
    lines = sightlines(pixels, cameras, confidence)
    points, has_parallax = best_hypotheses(lines, threshold, settings.min_parallax_rad)
    in_front = np.asarray(np.isfinite(points).all(axis=1))
    points = refine(lines, points, threshold)
    reprojection = _reprojection_px(points, pixels, cameras)
    inlier = lines.usable & (reprojection <= threshold)
    status = _status(
        [
            (lines.usable.sum(axis=1) < settings.min_views, Reason.TOO_FEW_VIEWS),
            (~has_parallax, Reason.DEGENERATE),
            (~in_front, Reason.BEHIND_CAMERA),
            (inlier.sum(axis=1) < settings.min_views, Reason.HIGH_REPROJECTION),
            (_spread_rad(lines, inlier) < settings.min_parallax_rad, Reason.DEGENERATE),
        ]
    )
    points[status != Reason.OK] = np.nan
    return Triangulation(points, inlier, reprojection, status)


def _triangulate_linearly(
    pixels: Pixels, cameras: Sequence[Camera], confidence: PerView, settings: _Settings
) -> Triangulation:
    lines = sightlines(pixels, cameras, confidence)
    enough = lines.usable.sum(axis=1) >= settings.min_views
    points = linear_points(lines, cameras, settings.weighted)
    points[~enough] = np.nan
    reprojection = _reprojection_px(points, pixels, cameras)
    inlier = lines.usable & (reprojection <= settings.max_reprojection_px)
    status = _status(
        [
            (~enough, Reason.TOO_FEW_VIEWS),
            (_spread_rad(lines, lines.usable) < settings.min_parallax_rad, Reason.DEGENERATE),
            (_any_view(lines.usable & (depth_along_rays_mm(lines, points) <= 0)), Reason.BEHIND_CAMERA),
            (_any_view(inlier != lines.usable), Reason.HIGH_REPROJECTION),
        ]
    )
    return Triangulation(points, inlier, reprojection, status)


def _reprojection_px(points: Points, pixels: Pixels, cameras: Sequence[Camera]) -> PerView:
    """Return the distance between pixels and projected points, exactly; NaN where either is missing."""
    projected = np.stack([camera.project(points) for camera in cameras], axis=1)
    return np.asarray(np.linalg.norm(projected - pixels, axis=-1))


def _spread_rad(lines: Sightlines, views: Views) -> Float64[np.ndarray, " point"]:
    """Return the angle that the rays of the given views span around their mean; exact for two rays."""
    rays = lines.rays * views[..., None]
    mean = rays.sum(axis=1)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean /= np.where(length > 0, length, 1.0)
    chord = np.linalg.norm(rays - mean[:, None], axis=-1) * views
    return np.asarray(4 * np.arcsin(np.minimum(chord.max(axis=1) / 2, 1.0)))


def _any_view(views: Views) -> Bool[np.ndarray, " point"]:
    return np.asarray(views.any(axis=1))


def _status(checks: list[tuple[Bool[np.ndarray, " point"], Reason]]) -> Status:
    """Return for each point the reason of the first check that holds, else `ok`."""
    masks, reasons = zip(*checks, strict=True)
    return np.select(masks, [reason.value for reason in reasons], default=Reason.OK.value)
