"""Grips: fingertips reach what they are to touch, in hands of any size."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import FINGERS
from assemblyhands_core.hands.kinematics import (
    MIRROR,
    HandPose,
    HandSkeleton,
    forward_kinematics,
    is_within_limits,
)
from assemblyhands_core.synthetic.grips import FLESH_MM, LEANS_RAD, PAD_MM, GripKind, HandGrip, solve_grips

KINDS = [
    GripKind("pinch", 26.0),
    GripKind("tripod", 13.5),
    GripKind("hold", 56.0),
    GripKind("round", 13.5),
    GripKind("round", 42.0),
    GripKind("wrap", 66.0),
]
TOUCHING = {"pinch": 2, "tripod": 3, "hold": 4, "wrap": 5}


def tips_in_grip(grip: HandGrip, angles: np.ndarray, skeleton: HandSkeleton) -> np.ndarray:
    joints = forward_kinematics(skeleton, HandPose("right", transforms.inverse(grip.T_wrist_from_grip), angles))
    return joints[[4 * FINGERS.index(finger) for finger in FINGERS]]


@pytest.mark.parametrize("kind", KINDS, ids=str)
@pytest.mark.parametrize("length_mm", [170.0, 205.0])
def test_pads_touch_the_object_within_a_millimetre(kind: GripKind, length_mm: float) -> None:
    skeleton = HandSkeleton.average(length_mm)
    for grip in solve_grips(skeleton, kind, "right"):
        tips = tips_in_grip(grip, grip.closed_rad, skeleton)
        is_round = kind.contact in ("round", "wrap")
        axis = [0, 1] if kind.contact == "round" else [0, 2]
        reach = np.linalg.norm(tips[:, axis], axis=-1) if is_round else np.abs(tips[:, 0])
        num_touching = TOUCHING.get(kind.contact, 3 if kind.width_mm < 30.0 else 4)
        assert_allclose(reach[:num_touching], kind.width_mm / 2 + PAD_MM, atol=1.0)
        assert tips[0, 0] < 0 < tips[1, 0]


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_hands_can_do_it_and_open_further(kind: GripKind) -> None:
    skeleton = HandSkeleton.average()
    grips = solve_grips(skeleton, kind, "right")
    assert len(grips) == len(LEANS_RAD)
    for grip in grips:
        assert is_within_limits(grip.closed_rad) and is_within_limits(grip.open_rad)
        closed, opened = (tips_in_grip(grip, angles, skeleton) for angles in (grip.closed_rad, grip.open_rad))
        assert opened[1, 0] - opened[0, 0] > closed[1, 0] - closed[0, 0] + 12.0


def test_the_left_hand_is_the_mirror_image() -> None:
    right, left = (solve_grips(HandSkeleton.average(), KINDS[0], hand) for hand in ("right", "left"))
    for one, other in zip(right, left, strict=True):
        assert_array_equal(other.T_wrist_from_grip, MIRROR @ one.T_wrist_from_grip @ MIRROR)
        assert_array_equal(other.closed_rad, one.closed_rad)


def test_flesh_is_thinner_than_pads_reach_and_thickest_at_the_wrist() -> None:
    tips = FLESH_MM[[0, 4, 8, 12, 16]]
    assert (tips <= PAD_MM).all() and FLESH_MM.argmax() == 20 and (FLESH_MM > 5.0).all()
