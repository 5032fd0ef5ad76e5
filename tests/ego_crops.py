"""Small sets of egocentric crops whose pictures show where each joint is."""

from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.hands.joints import HANDS, WRIST

SIZE_PX = 96
CAMERA = Camera("HMC_21110305_mono10bit", SIZE_PX, SIZE_PX, 160.0, 160.0, 47.5, 46.0, Pinhole(), np.eye(4))


def hands(frame: int) -> np.ndarray:
    """Joints (2, 21, 3) before the camera; the hand of a frame's crop lies in its middle, the other beside it."""
    rng = np.random.default_rng(frame)
    rays = rng.normal(size=(2, 5, 1, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    lengths = np.array([70.0, 55.0, 40.0, 25.0])[None, None, :, None]
    joints = np.concatenate([(rays * lengths).reshape(2, 20, 3), np.zeros((2, 1, 3))], axis=1)
    own = frame % 2
    joints[own] += [*rng.uniform(-8, 8, 2), 350.0]
    joints[1 - own] += [130.0, 40.0, 380.0]
    return joints


def picture(joints: np.ndarray) -> np.ndarray:
    """A spot for every joint, brighter from joint to joint, the right wrist brightest of all."""
    canvas = np.full((SIZE_PX, SIZE_PX, 3), 20, np.uint8)
    points = CAMERA.project(joints.reshape(-1, 3))
    for index, (x, y) in enumerate(points):
        cv2.circle(canvas, (round(16 * x), round(16 * y)), 16 * 2, (40 + 3 * index,) * 3, -1, cv2.LINE_AA, 4)
    x, y = points[WRIST]
    cv2.circle(canvas, (round(16 * x), round(16 * y)), 16 * 3, (255,) * 3, -1, cv2.LINE_AA, 4)
    return canvas


def ego_crops(num_frames: int) -> pa.Table:
    """Return crops of the right hand at even frames and of the left one at odd ones; one of frame 3 is missing."""
    rows: list[dict[str, Any]] = []
    for frame in range(num_frames):
        joints, own = hands(frame), frame % 2
        pixels = CAMERA.project(joints)
        relative = joints - joints[:, [WRIST]]
        name = {"sequence_id": "s", "frame": frame, "hand": HANDS[own], "camera_id": CAMERA.camera_id}
        is_there = frame != 3
        row = {
            **(camera_to_row(CAMERA) if is_there else missing_camera_row()),
            "image": encode_jpeg(picture(joints), 95) if is_there else b"",
            "joints_camera_mm": joints.ravel(),
            "joints_wrist_relative_mm": relative.ravel(),
            "joints_px": pixels.ravel(),
            "is_labelled": CAMERA.contains(pixels).ravel(),
            "identity": "both" if frame % 5 == 4 else HANDS[own],
            "num_in_image": int(CAMERA.contains(pixels[own]).sum()),
            "border_px": 5.0,
            "verb": "screw" if frame % 2 else "",
            "source": "manual",
            "valid": is_there,
            "reason": "" if is_there else "near_border",
        }
        rows.append(name | row)
    return EGO_CROPS.from_rows(rows)
