"""Hands in single egocentric pictures, in a few lines: for programs that are no pipeline.

from assemblyhands_core.infer import HandPredictor

predictor = HandPredictor("weights/svegonet.safetensors")
found = predictor.predict(image, camera, box=(210, 160, 300, 250), hand="right")
found.joints_camera_mm   # (21, 3), in the order of `hands.joints`
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from assemblyhands_core.data.ego_boxes import IDENTITIES, Identity
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.geometry.lifting import lifted_mm, wrist_depth_of_size_mm
from assemblyhands_core.hands.joints import BONES, Hand
from assemblyhands_core.hands.kinematics import HandSkeleton
from assemblyhands_core.models.ego_prediction import predict_hands
from assemblyhands_core.models.pretrained import load_svegonet

SHIPPED: Final = Path(__file__).resolve().parents[1] / "weights" / "svegonet.safetensors"
GAMMA: Final = 1.75
"""Side of a crop over that of its box, as in training (formats 2.7)."""


@dataclass(frozen=True, eq=False)
class PredictedHand:
    """A hand in a picture.

    Attributes:
        joints_px: In the picture, integers at pixel centres.
        depth_mm: Of each joint beyond the wrist, along the optical axis.
        joints_camera_mm: In the camera's frame: x right, y down, z forward.
        confidence: Of each joint, in [0, 1].
        identity: Whose joints the crop shows, in the network's eyes.
    """

    joints_px: Float[np.ndarray, "joint=21 2"]
    depth_mm: Float[np.ndarray, "joint=21"]
    joints_camera_mm: Float[np.ndarray, "joint=21 3"]
    confidence: Float[np.ndarray, "joint=21"]
    identity: Identity


class HandPredictor:
    """SVEgoNet, ready to be asked.

    Args:
        weights: Its file; by default the one that is shipped.
        num_threads: Of the CPU.

    Raises:
        ValueError: The file is of another network.
    """

    def __init__(self, weights: Path | str = SHIPPED, num_threads: int = 1) -> None:
        self._network = load_svegonet(Path(weights))
        self._num_threads = num_threads

    def predict(
        self,
        image: UInt8[np.ndarray, "height width 3"],
        camera: Camera,
        box: tuple[float, float, float, float],
        hand: Hand,
        wrist_depth_mm: float | None = None,
    ) -> PredictedHand:
        """Find one hand's joints.

        Args:
            image: RGB of a pinhole camera; a grey picture three times.
            camera: Its camera; the picture of a lens has to be rectified first (`geometry.regions`).
            box: Left, top, right, bottom of the hand in the picture.
            hand: Which it is.
            wrist_depth_mm: How far the wrist is from the camera; by default where the hand has a mean hand's size.

        Raises:
            ValueError: The camera is no pinhole, the picture is not its, or the box has no size.
        """
        if image.shape[1::-1] != (camera.width_px, camera.height_px):
            size = f"{image.shape[1]}×{image.shape[0]}"
            raise ValueError(
                f"Camera {camera.camera_id} has {camera.width_px}×{camera.height_px} px, the image {size}."
            )
        corners = np.array(box, dtype=np.float64).reshape(2, 2)
        center_px, side_px = corners.mean(axis=0), GAMMA * float((corners[1] - corners[0]).max())
        size_px = self._network.config.image_size_px
        crop = crop_camera(camera, center_px, side_px, size_px)
        picture = cv2.warpAffine(image, window_map(center_px, side_px, size_px)[:2], (size_px, size_px))
        seen = predict_hands(
            self._network, [np.asarray(picture, np.uint8)], [hand], batch_size=1, num_threads=self._num_threads
        )
        intrinsics_px = np.array([[crop.fx_px, crop.fy_px, crop.cx_px, crop.cy_px]])
        bones_mm = float(HandSkeleton.average().bone_lengths_mm.sum())
        depth_mm = np.array([wrist_depth_mm]) if wrist_depth_mm is not None else (
            wrist_depth_of_size_mm(seen.pixels, seen.depth_mm, intrinsics_px, BONES, bones_mm)
        )  # fmt: skip
        joints = lifted_mm(seen.pixels, seen.depth_mm, depth_mm, intrinsics_px)[0]
        return PredictedHand(
            joints_px=(seen.pixels[0] - (size_px - 1) / 2) * (side_px / size_px) + center_px,
            depth_mm=seen.depth_mm[0],
            joints_camera_mm=joints,
            confidence=seen.confidence[0],
            identity=IDENTITIES[int(seen.identity[0].argmax())],
        )
