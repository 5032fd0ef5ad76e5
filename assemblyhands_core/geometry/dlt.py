"""The linear triangulation (direct linear transform; Hartley & Zisserman, 12.2) of many points at once."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OVFishEye62
from assemblyhands_core.geometry.sightlines import Sightlines, tangents


def linear_points(lines: Sightlines, cameras: Sequence[Camera], weighted: bool) -> Float64[np.ndarray, "point 3"]:
    """Solve the homogeneous system of all usable views, one singular value decomposition per point.

    The minimiser depends on the units of the world, so they are left at mm as in the programs we compare with; the
    coefficients are formed from normalised coordinates, and a decomposition of the rows themselves, not of their
    squares, keeps all digits.

    Args:
        lines: Observations of the points.
        cameras: One for each view.
        weighted: Weigh rows by focal length and confidence, that is in pixels; otherwise all views alike in
            normalised units.

    Returns:
        Points in mm; NaN for a point at infinity.
    """
    rows = [
        np.where(lines.usable[:, view, None, None], _rows(lines, camera, view), 0.0)
        for view, camera in enumerate(cameras)
    ]
    if weighted:
        weights = [
            lines.confidence[:, view, None] * (camera.fx_px, camera.fy_px) for view, camera in enumerate(cameras)
        ]
        rows = [row * weight[..., None] for row, weight in zip(rows, weights, strict=True)]
    homogeneous = np.linalg.svd(np.concatenate(rows, axis=1), full_matrices=False)[2][:, -1]
    scale = homogeneous[:, 3:]
    return np.asarray(homogeneous[:, :3] / np.where(scale != 0, scale, np.nan))


def _rows(lines: Sightlines, camera: Camera, view: int) -> Float64[np.ndarray, "point 2 4"]:
    """Return two equations on the homogeneous world point.

    A perspective view gives r1 - x r3 and r2 - y r3 of [R | t] with normalised x, y; the rays of a fisheye need no
    positive z, so it gives two unit vectors normal to the ray.
    """
    pose = camera.T_camera_from_world[:3]
    ray = lines.rays[:, view] @ pose[:, :3].T
    if isinstance(camera.lens, OVFishEye62):
        return np.asarray(np.stack(tangents(ray), axis=1) @ pose)
    normals = np.zeros((len(ray), 2, 3))
    normals[:, 0, 0] = normals[:, 1, 1] = 1.0
    normals[:, :, 2] = -ray[:, :2] / np.where(ray[:, 2:] > 0, ray[:, 2:], np.nan)
    return np.asarray(normals @ pose)
