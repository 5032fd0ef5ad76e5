"""What cuts rectified regions out of raw pictures: remap grids, made once for a camera, and the regions themselves.

Full frames are never remapped for a crop: any region of a rectified view is sampled from the raw picture in one step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64, Int, Shaped, UInt8

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera, source_pixels

STEP_PX = 8.0
MAX_RESIDUAL_PX = 0.02
_MIN_STEP_PX = 1.0
_MARGIN = 0.5  # of the larger side: how far windows may leave the rectified image and still be filled
_MAX_SUPERSAMPLING = 4  # bounds the memory of a region that fills the picture
_OUTSIDE_PX = -1.0e4  # where maps point when there is no source pixel: far off any image, finite for cv2.remap


@dataclass(frozen=True, eq=False)
class RemapGrid:
    """Source pixels of a rectified image at every few pixels: made once per camera, then any window is two sums.

    Between nodes the map is bilinear. Its error is at most step²/8 times the sum of the map's second derivatives along
    x and y, some thousandths of a pixel for the real lenses; `build` halves the step until the measured error is small
    enough.

    Attributes:
        source_px: NaN where the source has no pixel.
        step_px: Distance of nodes in the rectified image.
        origin_px: Rectified pixel of the first node.
        intrinsics_px: fx, fy, cx, cy of the rectified camera.
    """

    source_px: Float32[np.ndarray, "row column 2"]
    step_px: float
    origin_px: Float64[np.ndarray, "2"]
    intrinsics_px: Float64[np.ndarray, "4"]

    @staticmethod
    def build(
        source: Camera, target: Camera, step_px: float = STEP_PX, max_residual_px: float = MAX_RESIDUAL_PX
    ) -> "RemapGrid":
        """Sample the exact map, on the target image and half its larger side around it.

        Args:
            source: The real camera.
            target: Its rectified camera.
            step_px: Distance of nodes to begin with; halved while the residual is larger than allowed.
            max_residual_px: Largest error of the map inside the source image.
        """
        grid = _sample_grid(source, target, step_px)
        while step_px > _MIN_STEP_PX and grid.residual_px(source, target) > max_residual_px:
            step_px /= 2
            grid = _sample_grid(source, target, step_px)
        return grid

    def residual_px(self, source: Camera, target: Camera) -> float:
        """Return the largest distance to the exact map, in source pixels, where it meets the source image.

        It is measured at the centres of the cells and of their sides, where bilinear interpolation errs most.
        """
        rows, columns = self.source_px.shape[:2]
        x = self.origin_px[0] + np.arange(0, columns - 1, 0.5) * self.step_px
        y = self.origin_px[1] + np.arange(0, rows - 1, 0.5) * self.step_px
        exact = source_pixels(source, target, np.stack(np.meshgrid(x, y), axis=-1))
        error = np.linalg.norm(np.moveaxis(self._interpolate(x, y), 0, -1) - exact, axis=-1)
        relevant = error[source.contains(exact)]
        return float(np.max(relevant, initial=0.0)) if np.isfinite(relevant).all() else float("inf")

    def window(self, crop: Camera) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
        """Return the maps (map_x, map_y) that cut a crop out of the raw source image.

        Args:
            crop: From `crop_camera` of the rectified camera, or the rectified camera itself.
        """
        fx, fy, cx, cy = self.intrinsics_px
        x = (np.arange(crop.width_px) - crop.cx_px) * (fx / crop.fx_px) + cx
        y = (np.arange(crop.height_px) - crop.cy_px) * (fy / crop.fy_px) + cy
        maps = self._interpolate(x, y)
        maps[np.isnan(maps)] = _OUTSIDE_PX
        return maps[0], maps[1]

    def to_bytes(self) -> bytes:
        """Serialise to the same bytes for the same grid, so that the grid can live in a table."""
        rows, columns = self.source_px.shape[:2]
        header = np.array([rows, columns, self.step_px, *self.origin_px, *self.intrinsics_px], dtype="<f8")
        return header.tobytes() + self.source_px.astype("<f4").tobytes()

    @staticmethod
    def from_bytes(data: bytes) -> "RemapGrid":
        """Read what `to_bytes` wrote.

        Raises:
            ValueError: The number of bytes does not match the header.
        """
        header = np.frombuffer(data[: 9 * 8], dtype="<f8")
        rows, columns = (int(value) for value in header[:2]) if len(header) == 9 else (0, 0)
        if not rows or len(data) != 9 * 8 + rows * columns * 2 * 4:
            raise ValueError(f"A remap grid of {len(data)} bytes is cut off: build the grids of this camera again.")
        nodes = np.frombuffer(data[9 * 8 :], dtype="<f4").reshape(rows, columns, 2)
        return RemapGrid(nodes.astype(np.float32), float(header[2]), header[3:5].copy(), header[5:].copy())

    def _interpolate(
        self, x: Float64[np.ndarray, " width"], y: Float64[np.ndarray, " height"]
    ) -> Float32[np.ndarray, "2 height width"]:
        """Evaluate both maps at ascending x and y: bilinear is separable on such a grid."""
        columns, x_weight = self._cells(x, axis=1)
        rows, y_weight = self._cells(y, axis=0)
        first_row, first_column = rows[0], columns[0]
        used = self.source_px[first_row : rows[-1] + 2, first_column : columns[-1] + 2]
        nodes = np.ascontiguousarray(np.moveaxis(used, -1, 0))
        lines = nodes.take(columns - first_column, axis=2)
        lines += (nodes.take(columns - first_column + 1, axis=2) - lines) * x_weight
        maps = lines.take(rows - first_row, axis=1)
        maps += (lines.take(rows - first_row + 1, axis=1) - maps) * y_weight[:, None]
        return np.asarray(maps)

    def _cells(
        self, positions: Float64[np.ndarray, " position"], axis: int
    ) -> tuple[Int[np.ndarray, " position"], Float32[np.ndarray, " position"]]:
        """Return the cell of each position and the place in it, NaN off the grid."""
        cell = (positions - self.origin_px[1 - axis]) / self.step_px
        last = self.source_px.shape[axis] - 1
        index = np.clip(np.floor(cell), 0, last - 1).astype(np.int64)
        weight = np.where((cell >= 0) & (cell <= last), cell - index, np.nan)
        return index, weight.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Region:
    """A square region of a view as it is stored.

    Attributes:
        camera: Its exact pinhole.
        image: Its picture.
    """

    camera: Camera
    image: UInt8[np.ndarray, "size size 3"]


def cut_region(
    picture: UInt8[np.ndarray, "height width 3"],
    rectified_camera: Camera,
    grid: RemapGrid,
    center_px: Sequence[float] | Float[np.ndarray, "2"],
    side_px: float,
    max_size_px: int,
) -> Region | None:
    """Cut a region of a rectified view out of the raw picture, None if the region shows nothing of it.

    Stored with at most ``max_size_px`` pixels a side, never more than the view has. A region that shrinks is sampled at
    a multiple of its size and averaged, which keeps its camera and avoids aliasing.

    Args:
        picture: As the source camera took it.
        rectified_camera: Pinhole of the rectified view, at its pose.
        grid: Of the source and the rectified camera, whatever their pose.
        center_px: Centre of the region in the rectified view.
        side_px: Side of the region in the rectified view.
        max_size_px: Largest side of the stored picture.
    """
    size_px = min(max_size_px, math.ceil(side_px))
    factor = min(math.ceil(side_px / size_px), _MAX_SUPERSAMPLING)
    maps = grid.window(crop_camera(rectified_camera, center_px, side_px, size_px * factor))
    if not _touches(picture, *maps):
        return None
    image = remap(picture, *maps)
    if factor > 1:
        image = np.asarray(cv2.resize(image, (size_px, size_px), interpolation=cv2.INTER_AREA))
    return Region(crop_camera(rectified_camera, center_px, side_px, size_px), image)


def _touches(
    picture: UInt8[np.ndarray, "height width 3"],
    map_x: Float32[np.ndarray, "map_height map_width"],
    map_y: Float32[np.ndarray, "map_height map_width"],
) -> bool:
    """Whether any source pixel of a map lies on the picture."""
    height, width = picture.shape[:2]
    return bool(np.any((map_x > -0.5) & (map_x < width - 0.5) & (map_y > -0.5) & (map_y < height - 0.5)))


def remap(
    image: Shaped[np.ndarray, "source_height source_width *channel"],
    map_x: Float32[np.ndarray, "height width"],
    map_y: Float32[np.ndarray, "height width"],
) -> Shaped[np.ndarray, "height width *channel"]:
    """Resample an image bilinearly by maps; black where there is no source pixel."""
    return np.asarray(cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def _sample_grid(source: Camera, target: Camera, step_px: float) -> RemapGrid:
    margin_px = step_px * np.ceil(max(target.width_px, target.height_px) * _MARGIN / step_px)
    x = np.arange(-margin_px, target.width_px + margin_px + step_px, step_px)
    y = np.arange(-margin_px, target.height_px + margin_px + step_px, step_px)
    nodes = source_pixels(source, target, np.stack(np.meshgrid(x, y), axis=-1))
    intrinsics = np.array([target.fx_px, target.fy_px, target.cx_px, target.cy_px])
    return RemapGrid(nodes.astype(np.float32), step_px, np.array([-margin_px, -margin_px]), intrinsics)
