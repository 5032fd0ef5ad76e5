"""What a set of pixels says about points: rays in the world and how pixels change beside them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int

from assemblyhands_core.geometry.cameras import Camera

_DIFFERENCE_RAD = 1e-6


@dataclass(frozen=True, eq=False)
class Sightlines:
    """Observations of points by views, linearised once at the observed pixel for any kind of lens.

    For a point X near the ray, with y = X - centre, the reprojection error in raw pixels is `rows @ y / (ray · y)` up
    to second order; the denominator is the distance along the ray and has to be positive.

    Attributes:
        rays: Unit rays in the world, 0 where the view is not usable.
        rows: Derivative of the pixel by the direction, in px, 0 where not usable.
        centers_mm: Camera centres in the world.
        confidence: Weight of the pixel error, 0 where the view is not usable.
    """

    rays: Float64[np.ndarray, "point view 3"]
    rows: Float64[np.ndarray, "point view 2 3"]
    centers_mm: Float64[np.ndarray, "view 3"]
    confidence: Float64[np.ndarray, "point view"]

    @property
    def usable(self) -> Bool[np.ndarray, "point view"]:
        """Tell which views have a pixel with a ray and a positive confidence."""
        return self.confidence > 0

    def select(self, points: Int[np.ndarray, " selected"]) -> "Sightlines":
        """Return the sight lines of some of the points."""
        return Sightlines(self.rays[points], self.rows[points], self.centers_mm, self.confidence[points])


def sightlines(
    pixels: Float64[np.ndarray, "point view 2"],
    cameras: Sequence[Camera],
    confidence: Float64[np.ndarray, "point view"],
) -> Sightlines:
    """Unproject raw pixels, each with its confidence, through the cameras of their views."""
    rays = np.empty((*pixels.shape[:2], 3))
    rows = np.empty((*pixels.shape[:2], 2, 3))
    for view, camera in enumerate(cameras):
        rays[:, view], rows[:, view] = _rays_and_rows(camera, pixels[:, view])
    usable = (confidence > 0) & np.isfinite(rays).all(axis=-1) & np.isfinite(rows).all(axis=(-1, -2))
    rays[~usable], rows[~usable] = 0.0, 0.0
    centers_mm = np.array([camera.center_world_mm for camera in cameras])
    return Sightlines(rays, rows, centers_mm, np.where(usable, confidence, 0.0))


def _rays_and_rows(
    camera: Camera, pixels: Float64[np.ndarray, "point 2"]
) -> tuple[Float64[np.ndarray, "point 3"], Float64[np.ndarray, "point 2 3"]]:
    """Return world rays and the change of the pixel when the ray turns."""
    rays = camera.unproject_camera(pixels)
    right, down = tangents(rays)
    change = [
        (camera.project_camera(rays + _DIFFERENCE_RAD * tangent) - pixels) / _DIFFERENCE_RAD
        for tangent in (right, down)
    ]
    rotation = camera.T_camera_from_world[:3, :3]
    tangents_world = np.stack((right, down), axis=-2) @ rotation
    return rays @ rotation, np.stack(change, axis=-1) @ tangents_world


def tangents(
    rays: Float64[np.ndarray, "point 3"],
) -> tuple[Float64[np.ndarray, "point 3"], Float64[np.ndarray, "point 3"]]:
    """Return two unit vectors that complete each ray to an orthonormal frame, without any branch cut in front.

    They turn the axes x and y by the rotation that takes z to the ray, which is singular only straight behind.
    """
    x, y, z = rays[:, 0], rays[:, 1], rays[:, 2]
    factor = -1.0 / np.where(z > -1 + 1e-12, 1.0 + z, np.nan)
    xy = x * y * factor
    return np.stack((1 + x * x * factor, xy, -x), axis=-1), np.stack((xy, 1 + y * y * factor, -y), axis=-1)
