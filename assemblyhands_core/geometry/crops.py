"""Rectified cameras, square crops with their exact cameras, and the maps that cut them out of raw images.

A *source* camera is the real one with its lens, a *target* is a pinhole at the same centre. A crop is itself a
pinhole camera, so whatever is found in a crop is triangulated with that camera and nothing has to be mapped back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, Shaped

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole

STEP_PX = 8.0
MAX_RESIDUAL_PX = 0.02
_MIN_STEP_PX = 1.0
_MARGIN = 0.5  # of the larger side: how far windows may leave the rectified image and still be filled
_MAX_CENTER_DISTANCE_MM = 1e-6
_OUTSIDE_PX = -1.0e4  # where maps point when there is no source pixel: far off any image, finite for cv2.remap


def rectified(camera: Camera, focal_scale: float = 1.0, size: tuple[int, int] | None = None) -> Camera:
    """Return the pinhole camera at the same pose that shows the scene without lens distortion.

    Args:
        camera: The real camera.
        focal_scale: Factor on both focal lengths; below 1 keeps more of the field (the release uses 0.7 for ego).
        size: Width and height in px, by default the camera's own; the image is cut or padded around its middle.

    Returns:
        The pinhole camera with the same `camera_id`.
    """
    width, height = size or (camera.width_px, camera.height_px)
    return replace(
        camera,
        width_px=width,
        height_px=height,
        fx_px=camera.fx_px * focal_scale,
        fy_px=camera.fy_px * focal_scale,
        cx_px=camera.cx_px + (width - camera.width_px) / 2,
        cy_px=camera.cy_px + (height - camera.height_px) / 2,
        lens=Pinhole(),
    )


def crop_camera(
    camera: Camera, center_px: Sequence[float] | Float[np.ndarray, "2"], side_px: float, size_px: int
) -> Camera:
    """Return the camera of a square window of a rectified image, resampled to another size.

    Window x spans [c - side/2, c + side/2]; with s = size/side a pixel x of the image is (x - c + side/2) s - 1/2 in
    the crop.

    Args:
        camera: Pinhole camera of the rectified image.
        center_px: Centre (x, y) of the window; it may lie outside the image and between pixels.
        side_px: Side of the window in the rectified image.
        size_px: Side of the crop in its own pixels.

    Raises:
        ValueError: The camera is no pinhole, or the window has no positive finite size.
    """
    x, y = (float(value) for value in center_px)
    if not isinstance(camera.lens, Pinhole):
        raise ValueError(f"Camera {camera.camera_id} has lens {camera.lens.model}: crop its rectified camera instead.")
    if not (np.isfinite([x, y, side_px]).all() and side_px > 0 and size_px > 0):
        raise ValueError(
            f"Camera {camera.camera_id}: a crop of side {side_px} px at ({x}, {y}) resampled to {size_px} px "
            "does not exist: give a finite centre and positive sizes."
        )
    scale = size_px / side_px
    return replace(
        camera,
        width_px=size_px,
        height_px=size_px,
        fx_px=camera.fx_px * scale,
        fy_px=camera.fy_px * scale,
        cx_px=(camera.cx_px - x + side_px / 2) * scale - 0.5,
        cy_px=(camera.cy_px - y + side_px / 2) * scale - 0.5,
    )


def square_box(points_px: Float[np.ndarray, "keypoint 2"], gamma: float) -> tuple[Float[np.ndarray, "2"], float]:
    """Return the square box around keypoints: L = γ · max(max x - min x, max y - min y).

    The paper (supplement, "Processing of exocentric images") centres it on the geometric centre of the keypoints;
    here that is the middle of their extent, so that with γ ≥ 1 no keypoint leaves its own box.

    Args:
        points_px: Rows with NaN are left out.
        gamma: Expansion coefficient, 1.5 on average in the paper.

    Returns:
        Centre and side L, both in px.

    Raises:
        ValueError: No row is finite.
    """
    known = points_px[np.isfinite(points_px).all(axis=-1)]
    if not len(known):
        raise ValueError(f"None of the {len(points_px)} keypoints is finite, so no box encloses them: skip this hand.")
    lower, upper = known.min(axis=0), known.max(axis=0)
    return (lower + upper) / 2, float(gamma * (upper - lower).max())


def source_pixels(
    source: Camera, target: Camera, pixels: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Return where pixels of the target lie in the raw source image, exactly; NaN where nowhere.

    Raises:
        ValueError: The two cameras do not share their centre, so no map between the images exists.
    """
    distance = float(np.linalg.norm(source.center_world_mm - target.center_world_mm))
    if distance > _MAX_CENTER_DISTANCE_MM:
        raise ValueError(
            f"Cameras {source.camera_id} and {target.camera_id} are {distance:.3g} mm apart: "
            "rectify and crop a camera at its own centre."
        )
    rotation = source.T_camera_from_world[:3, :3] @ target.T_camera_from_world[:3, :3].T
    return source.project_camera(target.unproject_camera(pixels) @ rotation.T)


def kept_field_fraction(source: Camera, target: Camera, step_px: float = STEP_PX) -> float:
    """Return the fraction of the source image, sampled every `step_px`, that the target image shows."""
    x, y = np.meshgrid(np.arange(0, source.width_px, step_px), np.arange(0, source.height_px, step_px))
    seen = source_pixels(target, source, np.stack((x, y), axis=-1))
    return float(target.contains(seen).mean())


def valid_mask(source: Camera, target: Camera) -> Bool[np.ndarray, "height width"]:
    """Tell for each pixel of the target image whether the source image has a pixel for it."""
    return source.contains(source_pixels(source, target, _pixel_centers(target)))


def valid_region(mask: Bool[np.ndarray, "height width"]) -> tuple[int, int, int, int]:
    """Return the bounding rectangle (x_min, y_min, x_max, y_max) of the true pixels of a mask, ends included.

    Raises:
        ValueError: No pixel is true.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        raise ValueError("The rectified image shows nothing of the source image: choose a smaller focal scale.")
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


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


def _pixel_centers(camera: Camera) -> Float64[np.ndarray, "height width 2"]:
    x, y = np.meshgrid(np.arange(camera.width_px, dtype=float), np.arange(camera.height_px, dtype=float))
    return np.stack((x, y), axis=-1)
