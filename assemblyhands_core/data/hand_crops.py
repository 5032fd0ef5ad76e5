"""Crops of hands as training and annotation see them: cut anew out of wider ones, with exact matrices.

The tables are those of `crop_hands`, for real recordings, or of `draw_crops`, for simulated ones. Whatever is done to a
crop (tighter, shifted, turned, smaller) is one affine map A of its pixels, so that its projection is A K [R | t].
"""

from dataclasses import dataclass

import cv2
import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Float64, UInt8

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.crop_images import ImageBytes, decode_image
from assemblyhands_core.hands.joints import NUM_JOINTS, Hand

HandKey = tuple[str, int, Hand]
"""Sequence, frame, hand."""


@dataclass(frozen=True, eq=False)
class StoredView:
    """One stored crop.

    Attributes:
        camera_id: Its view.
        image: Encoded picture.
        P_pixel_from_world: K [R | t], mm.
        size_px: Width and height.
    """

    camera_id: str
    image: ImageBytes
    P_pixel_from_world: Float64[np.ndarray, "3 4"]
    size_px: tuple[int, int]

    def project(self, points_world_mm: Float[np.ndarray, "point 3"]) -> Float64[np.ndarray, "point 2"]:
        """Return pixels of the stored crop; NaN behind the camera."""
        homogeneous = np.concatenate([points_world_mm, np.ones((len(points_world_mm), 1))], axis=1)
        x, y, depth = (homogeneous @ self.P_pixel_from_world.T).T
        is_ahead = depth > 0
        safe = np.where(is_ahead, depth, 1.0)
        return np.where(is_ahead[:, None], np.stack([x / safe, y / safe], axis=-1), np.nan)


@dataclass(frozen=True, eq=False)
class StoredHand:
    """All stored crops of one hand at one instant."""

    key: HandKey
    views: tuple[StoredView, ...]

    @property
    def is_left(self) -> bool:
        """Whether it is a left hand."""
        return self.key[2] == "left"


@dataclass(frozen=True, eq=False)
class HandLabel:
    """What is known of one hand at one instant.

    Attributes:
        joints_world_mm: NaN where not known.
        is_valid: Which joints are known.
        occlusion_rate: Of its joints in all views; NaN if unknown.
    """

    joints_world_mm: Float64[np.ndarray, "joint=21 3"]
    is_valid: Bool[np.ndarray, "joint=21"]
    occlusion_rate: float = float("nan")


@dataclass(frozen=True, eq=False)
class Cut:
    """One view as a network gets it.

    Attributes:
        image: RGB.
        P_pixel_from_world: Of its pixels.
        A_cut_from_stored: The map from pixels of the stored crop.
    """

    image: UInt8[np.ndarray, "size size 3"]
    P_pixel_from_world: Float64[np.ndarray, "3 4"]
    A_cut_from_stored: Float64[np.ndarray, "3 3"]


def stored_hands(crops: pa.Table) -> dict[HandKey, StoredHand]:
    """Group the rows of a `catalog.CROPS` table by hand and instant; views that are not valid are left out.

    Pictures stay where they are in the table: sets of crops for training are as large as half the memory.
    """
    matrices = _projections(crops)
    names = [crops.column(name).to_pylist() for name in ("sequence_id", "frame", "hand", "camera_id", "valid")]
    sizes = list(zip(*(crops.column(name).to_pylist() for name in ("width_px", "height_px")), strict=True))
    pictures = (scalar.as_buffer() for chunk in crops.column("image").chunks for scalar in chunk)
    found: dict[HandKey, list[StoredView]] = {}
    for row, (sequence, frame, hand, camera_id, is_valid), picture in zip(
        range(crops.num_rows), zip(*names, strict=True), pictures, strict=True
    ):
        if is_valid:
            view = StoredView(camera_id, picture, matrices[row], sizes[row])
            found.setdefault((sequence, frame, hand), []).append(view)
    return {key: StoredHand(key, tuple(views)) for key, views in found.items()}


def hand_labels(labels: pa.Table) -> dict[HandKey, HandLabel]:
    """Return the rows of a `training_tables.HAND_LABELS` table by hand and instant."""
    joints = to_numpy(labels["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3).astype(np.float64)
    valid = to_numpy(labels["valid"]).reshape(-1, NUM_JOINTS).astype(bool)
    rates = to_numpy(labels["occlusion_rate"]).astype(float)
    keys = zip(*(labels.column(name).to_pylist() for name in ("sequence_id", "frame", "hand")), strict=True)
    return {key: HandLabel(joints[i], valid[i], float(rates[i])) for i, key in enumerate(keys)}


def window_map(
    center_px: Float[np.ndarray, "2"], side_px: float, size_px: int, turn_rad: float = 0.0
) -> Float64[np.ndarray, "3 3"]:
    """Return the map from an image's pixels to those of a square window of it.

    Args:
        center_px: Middle of the window, integers at pixel centres.
        side_px: Of the window in the image.
        size_px: Of the window's own picture.
        turn_rad: By which the window's picture is turned, clockwise as seen.
    """
    scale = size_px / side_px
    cosine, sine = scale * np.cos(turn_rad), scale * np.sin(turn_rad)
    middle = (size_px - 1) / 2
    x, y = float(center_px[0]), float(center_px[1])
    return np.array(
        [
            [cosine, -sine, middle - cosine * x + sine * y],
            [sine, cosine, middle - sine * x - cosine * y],
            [0.0, 0.0, 1.0],
        ]
    )


def cut(view: StoredView, A_cut_from_stored: Float[np.ndarray, "3 3"], size_px: int, is_continued: bool = False) -> Cut:
    """Cut a window out of a stored crop; what lies outside it is black, or the crop's mirror image."""
    picture = decode_image(view.image)
    shrinks = np.hypot(A_cut_from_stored[0, 0], A_cut_from_stored[1, 0])
    picture, A = _reduced(picture, A_cut_from_stored, shrinks)
    border = cv2.BORDER_REFLECT_101 if is_continued else cv2.BORDER_CONSTANT
    image = cv2.warpAffine(picture, A[:2], (size_px, size_px), flags=cv2.INTER_LINEAR, borderMode=border)
    P = A_cut_from_stored @ view.P_pixel_from_world
    return Cut(np.asarray(image, dtype=np.uint8), P, np.asarray(A_cut_from_stored, dtype=np.float64))


def _reduced(
    picture: UInt8[np.ndarray, "height width 3"], A: Float[np.ndarray, "3 3"], scale: float
) -> tuple[UInt8[np.ndarray, "_height _width 3"], Float[np.ndarray, "3 3"]]:
    """Average pixels before a map that shrinks by more than half, so that nothing aliases."""
    factor = int(1 / scale) if scale > 0 else 1
    if factor < 2:
        return picture, A
    height, width = (side // factor * factor for side in picture.shape[:2])
    small = cv2.resize(picture[:height, :width], (width // factor, height // factor), interpolation=cv2.INTER_AREA)
    shift = (factor - 1) / 2
    enlarge = np.array([[factor, 0.0, shift], [0.0, factor, shift], [0.0, 0.0, 1.0]])
    return np.asarray(small, dtype=np.uint8), A @ enlarge


def _projections(crops: pa.Table) -> Float64[np.ndarray, "row 3 4"]:
    """Return K [R | t] of every row, which has to be a pinhole."""
    fx, fy, cx, cy = to_numpy(crops["intrinsics_px"]).reshape(-1, 4).T.astype(np.float64)
    poses = to_numpy(crops["T_camera_from_world"]).reshape(-1, 4, 4).astype(np.float64)[:, :3]
    x = fx[:, None] * poses[:, 0] + cx[:, None] * poses[:, 2]
    y = fy[:, None] * poses[:, 1] + cy[:, None] * poses[:, 2]
    return np.stack([x, y, poses[:, 2]], axis=1)
