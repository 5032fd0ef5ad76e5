"""Small sets of hands whose crops show where their joints are."""

from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CROPS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.training_tables import HAND_LABELS
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole

SIZE_PX = 96
ANGLES_RAD = (0.0, 0.9, 2.2, -1.1)


def camera(view: int) -> Camera:
    """A crop camera on a circle of 900 mm around the origin."""
    c, s = np.cos(ANGLES_RAD[view]), np.sin(ANGLES_RAD[view])
    pose = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 900.0], [0, 0, 0, 1.0]])
    return Camera(f"c{view}", SIZE_PX, SIZE_PX, 300.0, 300.0, 47.5, 47.5, Pinhole(), pose)


def joints(rng: np.random.Generator) -> np.ndarray:
    """A hand-like cloud: five rays of four joints and a wrist."""
    rays = rng.normal(size=(5, 1, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    lengths = np.array([90.0, 70.0, 50.0, 30.0])[None, :, None]
    return np.concatenate([(rays * lengths).reshape(20, 3), np.zeros((1, 3))]) + rng.uniform(-15, 15, 3)


def picture(view: Camera, points: np.ndarray) -> np.ndarray:
    """A bright spot for every joint, the root's the brightest."""
    canvas = np.full((SIZE_PX, SIZE_PX, 3), 40, np.uint8)
    pixels = view.project(points)
    for index in [i for i in range(21) if i != 11] + [11]:  # the root over all others
        x, y = pixels[index]
        color = (255, 255, 255) if index == 11 else (60 + 9 * index, 200 - 6 * index, 90)
        cv2.circle(canvas, (round(16 * x), round(16 * y)), 16 * 3, color, -1, cv2.LINE_AA, 4)
    return canvas


def hand_tables(num_frames: int) -> tuple[pa.Table, pa.Table]:
    """Return crops and labels of so many frames, right hands in even ones, left hands in odd ones."""
    crops: list[dict[str, Any]] = []
    labels: list[dict[str, Any]] = []
    for frame in range(num_frames):
        points = joints(np.random.default_rng(frame))
        name = {"sequence_id": "set", "frame": frame, "hand": "left" if frame % 2 else "right"}
        for view in range(len(ANGLES_RAD)):
            if view == 3 and frame == 0:
                row = {**missing_camera_row(), "image": b"", "valid": False, "reason": "outside_view"}
            else:
                image = encode_jpeg(picture(camera(view), points), 95)
                row = {**camera_to_row(camera(view)), "image": image, "valid": True, "reason": ""}
            crops.append({**name, "camera_id": f"c{view}", **row})
        known = {"joints_world_mm": points.ravel(), "valid": [True] * 21, "source": "truth"}
        labels.append({**name, **known, "verb": "", "occlusion_rate": 0.5})
    return CROPS.from_rows(crops), HAND_LABELS.from_rows(labels)
