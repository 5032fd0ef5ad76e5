"""Two hands for a round of annotation, and a network whose answer is known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row, valid_cameras
from assemblyhands_core.data.catalog import CROPS, HAND_BOXES, JOINTS, KEYPOINTS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.hands.joints import HANDS, ROOT
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, forward_kinematics
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet, MVExoNetConfig
from stages.annotate_round import AnnotateRoundConfig, BlendConfig, GuardConfig

SIZE_PX, CROP_PX, MARGIN, RADIUS_MM = 64, 96, 1.5, 130.0
FRAMES = (4, 5)
TINY = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=SIZE_PX, num_voxels=8, v2v="slim")
GUARD = GuardConfig(
    max_displacement_mm=100.0,
    max_body_distance_mm=250.0,
    min_size=0.6,
    max_size=1.5,
    max_bone_mm=150.0,
    max_reprojection_ratio=3.0,
    max_spread_ratio=1.25,
    max_course_px_ratio=1.5,
    min_instants=8,
    min_reprojection_px=12.0,
    min_view_share=0.5,
)
CONFIG = AnnotateRoundConfig(
    weights="weights.safetensors",
    gamma=1.5,
    min_box_joints=11,
    min_inside=0.5,
    min_views=2,
    min_confidence=0.1,
    min_keypoint_confidence=0.1,
    batch_size=8,
    stop_below_mm=0.0,
    blend=BlendConfig(share=0.0, within_mm=10.0),
    guard=GUARD,
)
Answer = Callable[[int, np.ndarray, bool], np.ndarray]  # (call's row, root, is left) → joints


def hand_at(hand: str, wrist_mm: tuple[float, float, float]) -> np.ndarray:
    """A slightly bent mean hand, fingers towards -y."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = wrist_mm
    return forward_kinematics(HandSkeleton.average(), HandPose(hand, pose, np.full(20, 0.2)))  # type: ignore[arg-type]


TRUE_MM = {
    (frame, hand): hand_at(hand, ((-200.0 if hand == "right" else 200.0) + 5 * frame, 60.0, -100.0))
    for frame in FRAMES
    for hand in HANDS
}
KEYS = list(TRUE_MM)


class KnownAnswer(MVExoNet):
    """A network that was told what to say, and remembers what it was shown."""

    def __init__(self, answer: Answer, confidence: float = 0.9) -> None:
        torch.nn.Module.__init__(self)
        self.config, self.answer, self.confidence = TINY, answer, confidence
        self.seen: list[Any] = []

    def forward(self, images: Any, P_pixel_from_world: Any, is_view_used: Any, root_world_mm: Any, is_left: Any) -> Any:
        first = len(self.seen)
        self.seen += zip(images, P_pixel_from_world.double(), is_view_used, root_world_mm, is_left, strict=True)
        roots = zip(root_world_mm.double().numpy(), is_left.tolist(), strict=True)
        joints = torch.from_numpy(np.stack([self.answer(first + i, *pair) for i, pair in enumerate(roots)])).float()
        confidence = torch.full(joints.shape[:2], self.confidence)
        return HandEstimate(joints, confidence, joints, torch.zeros(len(joints), 21, 2, 2, 2))


@dataclass
class Scene:
    """Two hands over two frames, as the stages before would tell of them."""

    world: Any
    inputs: dict[str, pa.Table]

    @property
    def cameras(self) -> list[Any]:
        return list(self.world.cameras)

    @property
    def rectified(self) -> Mapping[str, Any]:
        return valid_cameras(self.inputs["rectified_views"])


def center_of(key: tuple[int, str]) -> np.ndarray:
    return np.asarray(TRUE_MM[key].mean(axis=0) + np.array([10.0, 0.0, 0.0]))


def side_of(camera: Any, key: tuple[int, str]) -> float:
    return float(2 * RADIUS_MM * camera.fx_px / camera.depth_mm(center_of(key)))


def names_of(key: tuple[int, str], **more: Any) -> dict[str, Any]:
    return {"sequence_id": "s", "frame": key[0], "hand": key[1], **more}


def boxes_table(rectified: Mapping[str, Any]) -> pa.Table:
    rows = []
    for key in KEYS:
        for name, camera in rectified.items():
            box = {"center_rectified_px": camera.project(center_of(key)), "side_px": side_of(camera, key)}
            row = names_of(key, camera_id=name) | {"hand_center_world_mm": center_of(key), "source": "detected"}
            rows.append(row | box | {"valid": True, "reason": ""})
    return HAND_BOXES.from_rows(rows)


def crops_table(rectified: Mapping[str, Any], holes: tuple[str, ...] = ()) -> pa.Table:
    """Black crops with a blob where the root is."""
    rows = []
    for key in KEYS:
        for name, camera in rectified.items():
            is_valid = name not in holes
            place = camera.project(center_of(key)), MARGIN * side_of(camera, key)
            own = crop_camera(camera, *place, CROP_PX)
            y, x = np.mgrid[:CROP_PX, :CROP_PX]
            u, v = own.project(TRUE_MM[key][ROOT])
            blob = 250 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.5**2))
            image = encode_jpeg(np.repeat(blob[..., None], 3, axis=2).astype(np.uint8), 100)
            columns = camera_to_row(own) | {"image": image} if is_valid else missing_camera_row() | {"image": b""}
            reason = "" if is_valid else "outside_view"
            rows.append(names_of(key, camera_id=name) | columns | {"valid": is_valid, "reason": reason})
    return CROPS.from_rows(rows)


def keypoints_table(cameras: list[Any], offset_px: tuple[float, float] = (0.0, 0.0)) -> pa.Table:
    rows = []
    for key in KEYS:
        for camera in cameras:
            pixels = camera.project(TRUE_MM[key]) + offset_px
            row = names_of(key, camera_id=camera.camera_id) | {"keypoints_px": pixels, "confidence": np.ones(21)}
            rows.append(row | {"source": "test", "valid": True, "reason": ""})
    return KEYPOINTS.from_rows(rows)


def joints_table(
    number: int = 0,
    shift_mm: Any = 0.0,
    missing: tuple[int, ...] = (),
    source: str = "2d_triangulation",
    points: Mapping[tuple[int, str], np.ndarray] = TRUE_MM,
) -> pa.Table:
    rows = []
    for key in KEYS:
        valid = ~np.isin(np.arange(21), missing)
        found = np.where(valid[:, None], points[key] + shift_mm, np.nan)
        outcome = {"valid": valid, "reason": np.where(valid, "", "no_detection").tolist()}
        outcome |= {"num_views": np.full(21, 4), "reprojection_px": np.where(valid, 1.0, np.nan)}
        rows.append(names_of(key, joints_world_mm=found, source=source, round=number) | outcome)
    return JOINTS.from_rows(rows)


def truth_moved(*shift_mm: float) -> Answer:
    """The truth, in the order of the rows, moved."""
    return lambda row, root, is_left: TRUE_MM[KEYS[row]] + np.array(shift_mm or (0.0, 0.0, 0.0))


def points_of(row: dict[str, Any]) -> np.ndarray:
    return np.array(row["joints_world_mm"]).reshape(21, 3)


def truth_scaled(factor: float) -> Answer:
    return lambda row, root, is_left: root + factor * (TRUE_MM[KEYS[row]] - TRUE_MM[KEYS[row]][ROOT])
