"""The 17 body keypoints of COCO and the arm that leads to a hand.

Source: MS COCO keypoint order; the virtual hand centre is in the paper's supplement, "Processing of exocentric images".
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.joints import Hand

BODY_KEYPOINT_NAMES: Final = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
NUM_BODY_KEYPOINTS: Final = len(BODY_KEYPOINT_NAMES)

BODY_BONES: Final = (
    (5, 6),
    (5, 7),
    (7, 9),
    (6, 8),
    (8, 10),
    (5, 11),
    (6, 12),
    (11, 12),
    (11, 13),
    (13, 15),
    (12, 14),
    (14, 16),
)


class Arm(NamedTuple):
    """Indices of one arm's keypoints in COCO order."""

    shoulder: int
    elbow: int
    wrist: int


ARMS: Final[dict[Hand, Arm]] = {"right": Arm(6, 8, 10), "left": Arm(5, 7, 9)}


def hand_center(
    elbow: Float[np.ndarray, "*batch 3"], wrist: Float[np.ndarray, "*batch 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Return the virtual hand centre, a third of the forearm beyond the wrist, all in mm and the same frame.

    Returns:
        wrist + (wrist - elbow) / 3.

    Source: paper, supplement, "Processing of exocentric images".
    """
    return np.asarray(wrist + (wrist - elbow) / 3.0)
