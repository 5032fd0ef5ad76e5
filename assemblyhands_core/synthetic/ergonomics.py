"""How natural it is for a seated person to have a hand somewhere."""

from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.person import (
    SIDE,
    Subject,
    elbow_mm,
    forearm_twist_rad,
    resting_shoulder_mm,
    wrist_bend_rad,
)

# Middle and half width of what is comfortable in rad. Functional ranges (Ryu et al. 1991): wrist flexion 54°, extension
# 60°, radial 17° and ulnar 40° deviation; forearm 75° of pronation and 85° of supination.
_FLEXION: Final = (np.radians(-15.0), np.radians(35.0))
_ULNAR_DEVIATION: Final = (np.radians(8.0), np.radians(18.0))
_PRONATION: Final = (np.radians(25.0), np.radians(60.0))
_ELBOW_CLEARANCE_MM: Final = 60.0
_ELBOW_BELOW_SHOULDER_MM: Final = 60.0
_TABLE_TOP_MM: Final = -20.0
_TABLE_EDGE_MM: Final = -170.0


def discomfort(
    subject: Subject, hand: Hand, T_world_from_wrist: Float[np.ndarray, "*batch 4 4"]
) -> Float64[np.ndarray, "*batch"]:
    """Rate poses of a hand: 0 is the middle of all ranges, 3 is the sum of three angles at the edge of comfort.

    Args:
        subject: Who sits there, shoulders at rest.
        hand: Which hand.
        T_world_from_wrist: mm.

    Returns:
        Sum of fourth powers of angles over their comfortable range, so that only what is beyond really counts, plus
        what a stretched or folded arm and an elbow that is raised or below the table top cost.
    """
    shoulder = resting_shoulder_mm(subject, hand)
    wrist = T_world_from_wrist[..., :3, 3]
    elbow = elbow_mm(subject, hand, shoulder, wrist, T_world_from_wrist[..., :3, 1])
    bend = wrist_bend_rad(elbow, T_world_from_wrist)
    ulnar = -SIDE[hand] * bend[..., 1]
    twist = forearm_twist_rad(hand, shoulder, elbow, T_world_from_wrist)
    angles = ((bend[..., 0], _FLEXION), (ulnar, _ULNAR_DEVIATION), (twist, _PRONATION))
    cost = sum(((value - middle) / half) ** 4 for value, (middle, half) in angles)
    reach = np.linalg.norm(wrist - shoulder, axis=-1) / (subject.upper_arm_mm + subject.forearm_mm)
    cost = cost + 40.0 * np.maximum(reach - 0.92, 0.0) * 10.0 + 40.0 * np.maximum(0.45 - reach, 0.0)
    raised = np.maximum(elbow[..., 1] - shoulder[1] + _ELBOW_BELOW_SHOULDER_MM, 0.0) / 40.0
    cost = cost + raised**2
    sunk = np.maximum(_TABLE_TOP_MM + _ELBOW_CLEARANCE_MM - elbow[..., 1], 0.0) / 30.0
    return np.asarray(cost + np.where(elbow[..., 0] > _TABLE_EDGE_MM - 40.0, sunk**2, 0.0))
