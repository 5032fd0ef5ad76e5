"""Rows of the table `ego_tables.EGO_CROPS`: a hand's crop with the labels of both hands, or why there is none."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.ego_boxes import EgoBox, EgoRule, identity_of
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, Hand
from assemblyhands_core.hands.wrist import relative_to_wrist


def ego_crop_row(
    picture: tuple[UInt8[np.ndarray, "height width 3"], Camera],
    rectified: Camera,
    joints_world_mm: Float[np.ndarray, "hand=2 joint=21 3"],
    is_counted: Bool[np.ndarray, "hand=2 joint=21"],
    hand: Hand,
    box: EgoBox,
    rule: EgoRule,
    *,
    jpeg_quality: int,
) -> dict[str, Any]:
    """Return a crop's columns but for its names, verb and source.

    Args:
        picture: The crop and its camera.
        rectified: The camera that it was cut out of.
        joints_world_mm: Both hands, right hand first; NaN where not annotated.
        is_counted: Which of them count in this picture.
        hand: The one that the crop is around.
        box: Of that hand in the rectified picture.
        rule: Which crops are made.
        jpeg_quality: 1 to 100.
    """
    image, camera = picture
    own, pixels = HANDS.index(hand), camera.project(joints_world_mm)
    is_annotated = np.isfinite(joints_world_mm).all(axis=-1, keepdims=True)
    in_camera = np.where(is_annotated, camera.to_camera(joints_world_mm), np.nan)
    other_px = rectified.project(joints_world_mm[1 - own])
    return {
        **camera_to_row(camera),
        "image": encode_jpeg(image, jpeg_quality),
        "joints_camera_mm": in_camera.ravel(),
        "joints_wrist_relative_mm": relative_to_wrist(in_camera.reshape(1, NUM_BOTH, 3)).ravel(),
        "joints_px": pixels.ravel(),
        "is_labelled": (is_counted & camera.contains(pixels)).ravel(),
        "identity": identity_of(box, hand, other_px, is_counted[1 - own], rule),
        "num_in_image": box.num_in_image,
        "border_px": box.border_px,
        "valid": True,
        "reason": "",
    }


def ego_hole_row(box: EgoBox, reason: str = "missing_frame") -> dict[str, Any]:
    """Return the columns of a hand without a crop but for its names: for the box's reason, else for the one given."""
    unknown = np.full(3 * NUM_BOTH, np.nan)
    return {
        **missing_camera_row(),
        "image": b"",
        "joints_camera_mm": unknown,
        "joints_wrist_relative_mm": unknown,
        "joints_px": np.full(2 * NUM_BOTH, np.nan),
        "is_labelled": np.zeros(NUM_BOTH, dtype=bool),
        "identity": "",
        "num_in_image": box.num_in_image,
        "border_px": box.border_px,
        "verb": "",
        "source": "",
        "valid": False,
        "reason": box.reason or reason,
    }
