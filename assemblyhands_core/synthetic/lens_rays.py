"""The rays of a camera's pixels, through its true lens."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64, Int32

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Lens, Pinhole
from assemblyhands_core.synthetic.compiled import compiled

MAX_RESIDUAL_PX = 0.002
_STEP_PX = 16
_MIN_STEP_PX = 1
_SAFETY = 1.2
_MIN_DEPTH = 0.1  # of unit rays: 84° off the axis; a lens that sees further is interpolated on the unit sphere
_ORIGIN_PX = -1.0  # of the first node: outside the first pixel, whose left edge is -0.5
_LENSES_KEPT = 64


@dataclass(frozen=True, eq=False)
class LensRays:
    """The ray of every pixel in the camera frame.

    Made from exact rays at every few pixels by interpolation, which takes a tenth of the time: of a pinhole it is
    exact, of other lenses the step is so small that the largest error stays below `MAX_RESIDUAL_PX`.

    Attributes:
        rays: Unit; NaN outside the field of the lens.
        step_px: Distance of the exact rays.
    """

    rays: Float32[np.ndarray, "height width 3"]
    step_px: int

    @staticmethod
    def of(camera: Camera) -> "LensRays":
        """Return the rays of a camera, kept for the next time if its lens is not trivial."""
        numbers = camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
        if isinstance(camera.lens, Pinhole):
            return _build(*numbers, camera.lens)
        return _build_once(*numbers, camera.lens)  # type: ignore[arg-type]  # lenses are frozen, so hashable

    def world(self, camera: Camera, pixels: Int32[np.ndarray, " ray"]) -> Float32[np.ndarray, "ray 3"]:
        """Return unit rays in the world, NaN outside the field of the lens.

        Args:
            camera: Whose lens this is, at any pose.
            pixels: Flat indices, row · width + column.
        """
        return _rotated(self.rays.reshape(-1, 3), pixels, _rotation(camera))

    def points(
        self, camera: Camera, pixels: Int32[np.ndarray, " ray"], distances_mm: Float32[np.ndarray, "height width"]
    ) -> Float32[np.ndarray, "ray 3"]:
        """Return points in the world at some pixels' distances along their rays.

        Args:
            camera: As of `world`.
            pixels: As of `world`.
            distances_mm: Of all pixels.
        """
        center_mm = camera.center_world_mm.astype(np.float32)
        return _reached(self.rays.reshape(-1, 3), pixels, _rotation(camera), distances_mm.reshape(-1), center_mm)


def _build(width: int, height: int, fx: float, fy: float, cx: float, cy: float, lens: Lens) -> LensRays:
    camera = Camera("lens", width, height, fx, fy, cx, cy, lens, np.eye(4))
    step = 2 * max(width, height) if isinstance(lens, Pinhole) else _STEP_PX
    nodes = _nodes(camera, step)
    if not isinstance(lens, Pinhole):
        residual_px = _largest_difference(nodes, _nodes(camera, step // 2)) * max(fx, fy)
        while step > _MIN_STEP_PX and _SAFETY * residual_px > MAX_RESIDUAL_PX:
            step, residual_px = step // 2, residual_px / 4  # between nodes the error grows with the step squared
        nodes = _nodes(camera, step)
    return LensRays(_interpolate(nodes, step, width, height), step)


_build_once = lru_cache(_LENSES_KEPT)(_build)


def _nodes(camera: Camera, step: int) -> Float64[np.ndarray, "row column 3"]:
    x, y = (_ORIGIN_PX + np.arange(0, size + 2 * step, step) for size in (camera.width_px, camera.height_px))
    rays = camera.unproject_camera(np.stack(np.meshgrid(x, y), axis=-1))
    # A pinhole is linear in x/z and y/z only, however far its nodes lie off the axis (oblique crops of a fisheye).
    is_flat = isinstance(camera.lens, Pinhole) or np.nanmin(rays[..., 2]) > _MIN_DEPTH
    return rays / rays[..., 2:] if is_flat else rays


def _largest_difference(
    nodes: Float64[np.ndarray, "row column 3"], finer: Float64[np.ndarray, "finer_row finer_column 3"]
) -> float:
    """Return the largest angle between rays that are interpolated half-way between nodes and the true ones."""
    columns = np.stack((nodes[:, :-1], (nodes[:, :-1] + nodes[:, 1:]) / 2), axis=2).reshape(len(nodes), -1, 3)
    between = np.stack((columns[:-1], (columns[:-1] + columns[1:]) / 2), axis=1).reshape(-1, columns.shape[1], 3)
    rows, columns_ = (min(a, b) for a, b in zip(between.shape[:2], finer.shape[:2], strict=True))
    difference = _unit(between[:rows, :columns_]) - _unit(finer[:rows, :columns_])
    return float(np.nanmax(np.linalg.norm(difference, axis=-1), initial=0.0))


def _unit(rays: Float64[np.ndarray, "row column 3"]) -> Float64[np.ndarray, "row column 3"]:
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


@compiled
def _interpolate(
    nodes: Float64[np.ndarray, "row column 3"], step: int, width: int, height: int
) -> Float32[np.ndarray, "height width 3"]:
    rays = np.empty((height, width, 3), np.float32)
    for y in range(height):
        row = int((y - _ORIGIN_PX) / step)
        down = (y - _ORIGIN_PX) / step - row
        for x in range(width):
            column = int((x - _ORIGIN_PX) / step)
            right = (x - _ORIGIN_PX) / step - column
            squared = 0.0
            for axis in range(3):
                above = nodes[row, column, axis] * (1 - right) + nodes[row, column + 1, axis] * right
                below = nodes[row + 1, column, axis] * (1 - right) + nodes[row + 1, column + 1, axis] * right
                rays[y, x, axis] = above * (1 - down) + below * down
                squared += rays[y, x, axis] ** 2
            rays[y, x] /= np.sqrt(squared)
    return rays


def _rotation(camera: Camera) -> Float32[np.ndarray, "3 3"]:
    """Return the rotation from the camera's frame to the world."""
    return np.asarray(camera.T_camera_from_world[:3, :3].T.astype(np.float32, order="C"))


@compiled
def _reached(
    rays: Float32[np.ndarray, "pixel 3"],
    pixels: Int32[np.ndarray, " ray"],
    rotation: Float32[np.ndarray, "3 3"],
    distances: Float32[np.ndarray, " pixel"],
    center: Float32[np.ndarray, "3"],
) -> Float32[np.ndarray, "ray 3"]:
    points = np.empty((len(pixels), 3), np.float32)
    for i in range(len(pixels)):
        x, y, z = rays[pixels[i], 0], rays[pixels[i], 1], rays[pixels[i], 2]
        distance = distances[pixels[i]]
        for axis in range(3):
            turned = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
            points[i, axis] = turned * distance + center[axis]
    return points


@compiled
def _rotated(
    rays: Float32[np.ndarray, "pixel 3"], pixels: Int32[np.ndarray, " ray"], rotation: Float32[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "ray 3"]:
    turned = np.empty((len(pixels), 3), np.float32)
    for i in range(len(pixels)):
        x, y, z = rays[pixels[i], 0], rays[pixels[i], 1], rays[pixels[i], 2]
        for axis in range(3):
            turned[i, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
    return turned
