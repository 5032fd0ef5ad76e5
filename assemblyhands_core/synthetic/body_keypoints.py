"""Where the keypoints of a body are in a state of a take, as body detectors know them (COCO-17)."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.take import State

# Of the head, in the headset's frame: x to the wearer's right, y down, z ahead.
_HEAD_MM: Final[Mapping[str, tuple[float, float, float]]] = {
    "nose": (0.0, 25.0, 100.0),
    "left_eye": (-32.0, -12.0, 85.0),
    "right_eye": (32.0, -12.0, 85.0),
    "left_ear": (-74.0, 0.0, 0.0),
    "right_ear": (74.0, 0.0, 0.0),
}
_HIP_MM: Final = 95.0  # to either side of the trunk's origin


def body_keypoints_mm(state: State) -> Float64[np.ndarray, "keypoint=17 3"]:
    """Return the body's keypoints in the world; NaN for the legs, which the studio does not draw."""
    posture = state.posture
    T_world_from_headset = transforms.inverse(state.T_headset_from_world)
    points = {name: transforms.apply(T_world_from_headset, np.array(place)) for name, place in _HEAD_MM.items()}
    for hand, side in (("right", 1.0), ("left", -1.0)):
        points[f"{hand}_hip"] = transforms.apply(posture.T_world_from_trunk, np.array([0.0, 0.0, side * _HIP_MM]))
    for hand in HANDS:
        points[f"{hand}_shoulder"] = posture.shoulders_mm[hand]
        points[f"{hand}_elbow"] = posture.elbows_mm[hand]
        points[f"{hand}_wrist"] = posture.wrists_mm[hand]
    return np.stack([points.get(name, np.full(3, np.nan)) for name in BODY_KEYPOINT_NAMES])
