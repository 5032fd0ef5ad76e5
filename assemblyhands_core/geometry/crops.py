"""Rectified cameras and square crops with their exact cameras.

A *source* camera is the real one with its lens, a *target* is a pinhole at the same centre. A crop is itself a
pinhole camera, so whatever is found in a crop is triangulated with that camera and nothing has to be mapped back.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Float64

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole

_STEP_PX = 8.0
_MAX_CENTER_DISTANCE_MM = 1e-6


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


def kept_field_fraction(source: Camera, target: Camera, step_px: float = _STEP_PX) -> float:
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


def _pixel_centers(camera: Camera) -> Float64[np.ndarray, "height width 2"]:
    x, y = np.meshgrid(np.arange(camera.width_px, dtype=float), np.arange(camera.height_px, dtype=float))
    return np.stack((x, y), axis=-1)
