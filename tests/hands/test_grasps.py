"""Named grasps: within the limits, and holding what their names say."""

import numpy as np
import pytest

from assemblyhands_core.hands.grasps import GRASPS, Grasp, blended_grasps_rad, grasp_angles_rad
from assemblyhands_core.hands.joints import FINGERS
from assemblyhands_core.hands.kinematics import (
    HandPose,
    HandSkeleton,
    finger_frames,
    forward_kinematics,
    is_within_limits,
)

SKELETON = HandSkeleton.average()


def tips(grasp: Grasp) -> dict[str, np.ndarray]:
    joints = forward_kinematics(SKELETON, HandPose("right", np.eye(4), grasp_angles_rad(grasp)))
    return {finger: joints[4 * i] for i, finger in enumerate(FINGERS)}


def gap_mm(grasp: Grasp, one: str, other: str) -> float:
    return float(np.linalg.norm(tips(grasp)[one] - tips(grasp)[other]))


@pytest.mark.parametrize("grasp", GRASPS)
def test_every_grasp_can_be_reached_by_a_hand(grasp: Grasp) -> None:
    assert grasp_angles_rad(grasp).shape == (20,)
    assert is_within_limits(grasp_angles_rad(grasp))


def test_pads_meet_where_they_hold_something() -> None:
    assert 13.0 < gap_mm("pinch", "thumb", "index") < 20.0  # two pads of 7 mm and next to nothing between
    assert 18.0 < gap_mm("tripod", "thumb", "index") < 28.0
    assert 18.0 < gap_mm("tripod", "thumb", "middle") < 28.0
    assert 30.0 < gap_mm("screwdriver", "thumb", "index") < 42.0
    assert gap_mm("open", "thumb", "index") > 90.0


def test_thumb_and_index_pads_face_each_other_in_the_pinch() -> None:
    frames = finger_frames(SKELETON, HandPose("right", np.eye(4), grasp_angles_rad("pinch")))
    towards = tips("pinch")["index"] - tips("pinch")["thumb"]
    towards /= np.linalg.norm(towards)
    assert -frames[0, 6, :3, 2] @ towards > 0.6
    assert frames[1, 6, :3, 2] @ towards > 0.6


def test_the_fist_is_closed_and_the_flat_hand_straight() -> None:
    for finger in FINGERS[1:]:
        assert np.linalg.norm(tips("fist")[finger]) < 95.0 < 130.0 < np.linalg.norm(tips("flat")[finger])


@pytest.mark.parametrize("grasp", GRASPS)
def test_no_grasp_passes_through_its_own_fingers(grasp: Grasp) -> None:
    joints = forward_kinematics(SKELETON, HandPose("right", np.eye(4), grasp_angles_rad(grasp)))
    share = np.linspace(0.0, 1.0, 9)[:, None]
    bones = [[4 * f + k for k in range(2)] for f in range(5)]  # the two outer bones of each finger
    lines = [np.concatenate([joints[j] + share * (joints[j + 1] - joints[j]) for j in finger]) for finger in bones]
    for i, one in enumerate(lines):
        for other in lines[i + 1 :]:
            assert np.linalg.norm(one[:, None] - other, axis=-1).min() > 10.0


def test_blending_runs_from_one_grasp_to_the_other() -> None:
    flat, fist = grasp_angles_rad("flat"), grasp_angles_rad("fist")
    path = blended_grasps_rad(flat[None], fist[None], np.array([0.0, 0.25, 1.0]))
    assert path == pytest.approx(np.stack([flat, 0.75 * flat + 0.25 * fist, fist]))
    assert blended_grasps_rad(flat, fist, 0.5) == pytest.approx((flat + fist) / 2)
    assert is_within_limits(blended_grasps_rad(flat, fist, 3.0))
