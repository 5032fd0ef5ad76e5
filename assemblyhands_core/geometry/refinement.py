"""Robust refinement of points by iteratively reweighted Gauss-Newton on their pixel errors."""

import numpy as np
from jaxtyping import Bool, Float64

from assemblyhands_core.geometry.sightlines import Sightlines

Points = Float64[np.ndarray, "point 3"]
PerView = Float64[np.ndarray, "point view"]

_REACH = 2.0  # in units of the threshold: views farther off have no weight
_DAMPING = 1e-12
_MAX_STEPS = 50
_CONVERGED_MM = 1e-7


def refine(lines: Sightlines, points: Points, max_reprojection_px: float) -> Points:
    """Take Gauss-Newton steps until they are shorter than 1e-7 mm; only points that still move take more.

    Args:
        lines: Observations of the points.
        points: In mm, to start from; NaN stays NaN.
        max_reprojection_px: Pixel error at which a view has a quarter of its weight.

    Returns:
        Points in mm.
    """
    refined = points.copy()
    active = np.flatnonzero(np.isfinite(points).all(axis=1))
    for _ in range(_MAX_STEPS):
        if not len(active):
            break
        lines_left = lines.select(active)
        moved = gauss_newton_step(lines_left, refined[active], max_reprojection_px)
        step_mm = np.abs(moved - refined[active]).max(axis=1, initial=0)
        refined[active] = moved
        active = active[step_mm > _CONVERGED_MM]
    return refined


def gauss_newton_step(lines: Sightlines, points: Points, max_reprojection_px: float) -> Points:
    """Move all points one step towards the least weighted sum of squared pixel errors.

    With y = X - c, depth λ = ray · y and error r = rows y / λ, the derivative of r is (rows - r rayᵀ) / λ. Weights are
    confidence² / (1 + |r|²/threshold²)² (Geman & McClure), and 0 behind a camera and beyond twice the threshold. A cut
    at the threshold would cost another 10 % of accuracy where the noise is half as large as the threshold.

    Args:
        lines: Observations of the points.
        points: In mm.
        max_reprojection_px: The threshold, at which a view has a quarter of its weight.

    Returns:
        Points in mm; unchanged where fewer than two views take part.
    """
    offset = points[:, None] - lines.centers_mm
    depth = depth_along_rays_mm(lines, points)
    inverse_depth = 1.0 / np.where(depth > 0, depth, np.inf)
    error = (lines.rows @ offset[..., None])[..., 0] * inverse_depth[..., None]
    weight = _weights(lines, error, depth > 0, max_reprojection_px)
    jacobian = (lines.rows - error[..., None] * lines.rays[:, :, None]) * inverse_depth[..., None, None]
    shape = (len(points), 2 * lines.rays.shape[1])
    left = (jacobian * weight[..., None, None]).reshape(*shape, 3).swapaxes(1, 2)
    normal = left @ jacobian.reshape(*shape, 3)
    gradient = left @ error.reshape(*shape, 1)
    solvable = (weight > 0).sum(axis=1) >= 2
    return points - np.where(solvable[:, None], _solve(normal, gradient, solvable), 0.0)


def depth_along_rays_mm(lines: Sightlines, points: Points) -> PerView:
    """Return how far points in mm lie from the cameras along the observed rays; negative behind them."""
    return np.asarray((lines.rays * (points[:, None] - lines.centers_mm)).sum(axis=-1))


def _weights(
    lines: Sightlines,
    error: Float64[np.ndarray, "point view 2"],
    in_front: Bool[np.ndarray, "point view"],
    max_reprojection_px: float,
) -> PerView:
    squared = (error**2).sum(axis=-1) / max_reprojection_px**2
    return np.where(in_front & (squared <= _REACH**2), (lines.confidence / (1 + squared)) ** 2, 0.0)


def _solve(
    normal: Float64[np.ndarray, "point 3 3"],
    gradient: Float64[np.ndarray, "point 3 1"],
    solvable: Bool[np.ndarray, " point"],
) -> Points:
    """Solve the 3x3 systems, each with a trace of damping so that parallel rays give a number, not an exception."""
    size = np.trace(normal, axis1=1, axis2=2)[:, None, None]
    safe = np.where(solvable[:, None, None] & (size > 0), normal + _DAMPING * size * np.eye(3), np.eye(3))
    return np.asarray(np.linalg.solve(safe, gradient)[..., 0])
