"""A miniature of the AssemblyHands release: rectified pictures of two headset cameras, their poses, boxes and joints.

Pictures show a spot for every joint, so that a tiny network can learn them. Keys begin at 124 and step by 2.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from ego_crops import hands

from assemblyhands_core.data.assemblyhands import (
    EgoCalibration,
    JointAnnotations,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.assemblyhands_images import Box, EgoImage, ego_image_file, write_ego_images
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.names import ego_image_name
from assemblyhands_core.hands.joints import HANDS, Hand

CAMERAS = ("HMC_21176623_mono10bit", "HMC_21110305_mono10bit")
SIZE_PX = (200, 160)
K = np.array([[160.0, 0.0, 99.5], [0.0, 160.0, 79.5], [0.0, 0.0, 1.0]])
FIRST_KEY, NUM_FRAMES = 124, 8
TRAIN, TEST = (
    "nusar-2021_action_both_9014-a23_9014_user_id_2021-02-02_142800",
    "nusar-2021_action_both_9012-c07c_9012_user_id_2021-02-01_164345",
)
SPLITS = {TRAIN: "train", TEST: "val"}


def true_joints(recording: str) -> np.ndarray:
    """Joints (frame, 2, 21, 3) in the world."""
    first = 100 * list(SPLITS).index(recording)
    return np.stack([hands(first + frame) for frame in range(NUM_FRAMES)])


def pose(camera: int) -> np.ndarray:
    """T_camera_from_world: the second camera stands 3 cm beside the first."""
    T = np.eye(4)
    T[0, 3] = -30.0 * camera
    return T


def project(joints_world: np.ndarray, camera: int) -> np.ndarray:
    """Pixels of points."""
    in_camera = joints_world @ pose(camera)[:3, :3].T + pose(camera)[:3, 3]
    homogeneous = in_camera @ K.T
    return homogeneous[..., :2] / homogeneous[..., 2:]


def write_release(root: Path) -> DatasetLayout:
    """Write annotations and pictures of both recordings; there are no videos of fixed cameras."""
    layout = DatasetLayout(root)
    for recording, split in SPLITS.items():
        joints, keys = true_joints(recording), FIRST_KEY + 2 * np.arange(NUM_FRAMES)
        is_valid = np.ones(joints.shape[:3], dtype=bool)
        is_valid[1, 0, 3] = False
        write_joint_annotations(
            layout.annotations(split, "joint_3d"), {recording: JointAnnotations(keys, joints, is_valid)}
        )
        poses = np.tile(np.stack([pose(camera) for camera in range(len(CAMERAS))]), (NUM_FRAMES, 1, 1, 1))
        poses[2, 1] = np.nan  # a frame may lack a camera
        ego = EgoCalibration(CAMERAS, np.tile(K, (len(CAMERAS), 1, 1)), keys, poses)
        write_ego_calibration(layout.annotations(split, "ego_calib"), {recording: ego})
        write_ego_images(layout.annotations(split, "ego_data"), _images(layout, recording, split, joints, is_valid))
    return layout


def _images(
    layout: DatasetLayout, recording: str, split: str, joints: np.ndarray, is_valid: np.ndarray
) -> Sequence[EgoImage]:
    images = []
    for frame, both in enumerate(joints):
        for index, camera_id in enumerate(CAMERAS):
            key, pixels = FIRST_KEY + 2 * frame, project(both, index)
            name = ego_image_file(split, recording, camera_id, key)
            _write_picture(layout.images / name, pixels)
            boxes: dict[Hand, Box] = {h: _box(px) for h, px in zip(HANDS, pixels, strict=True) if _is_inside(px)}
            images.append(EgoImage(recording, ego_image_name(camera_id), key, name, SIZE_PX, boxes, is_valid[frame]))
    return images


def _is_inside(pixels: np.ndarray) -> bool:
    return bool(((pixels > 0) & (pixels < np.array(SIZE_PX) - 1)).all())


def _box(pixels: np.ndarray) -> Box:
    (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    return left, top, right, bottom


def _write_picture(path: Path, pixels: np.ndarray) -> None:
    canvas = np.full(SIZE_PX[::-1], 20, np.uint8)
    for index, (x, y) in enumerate(pixels.reshape(-1, 2)):
        cv2.circle(canvas, (round(16 * x), round(16 * y)), 16 * 2, 40 + 3 * index, -1, cv2.LINE_AA, 4)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), canvas, [cv2.IMWRITE_JPEG_QUALITY, 95])
