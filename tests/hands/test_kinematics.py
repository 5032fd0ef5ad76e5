"""The hand as a kinematic chain, against bends worked out by hand."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import FINGERS, JOINT_NAMES, ROOT, WRIST, Hand
from assemblyhands_core.hands.kinematics import (
    ANGLE_NAMES,
    JOINT_LIMITS_RAD,
    MIRROR,
    NUM_ANGLES,
    HandPose,
    HandSkeleton,
    bone_lengths_mm,
    clamp_to_limits,
    finger_frames,
    forward_kinematics,
    is_within_limits,
    mirrored,
)

Array = npt.NDArray[np.float64]
SKELETON = HandSkeleton.average()
MIDDLE = dict(zip(("tip", "dip", "pip", "mcp"), range(8, 12), strict=True))

angles = arrays(np.float64, NUM_ANGLES, elements=st.floats(-4.0, 4.0))
hands = st.sampled_from(["right", "left"])


def turned(seed: int) -> Array:
    """Some rigid transform."""
    generator = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    return transforms.rigid(rotation * np.sign(np.linalg.det(rotation)), generator.normal(0, 300, 3))


def bent(**degrees: float) -> Array:
    """Angles by name, the others zero."""
    given_angles = np.zeros(NUM_ANGLES)
    for name, value in degrees.items():
        given_angles[ANGLE_NAMES.index(name)] = np.deg2rad(value)
    return given_angles


def joints(angles_rad: Array, hand: Hand = "right") -> Array:
    return forward_kinematics(SKELETON, HandPose(hand, np.eye(4), angles_rad))


def test_a_straight_finger_is_its_bones_in_a_row() -> None:
    straight = joints(bent())
    assert straight[MIDDLE["mcp"]] == pytest.approx([-2.0, 93.0, 2.0])
    assert straight[MIDDLE["tip"]] == pytest.approx([-2.0, 93.0 + 44.6 + 26.3 + 17.4, 2.0])
    assert straight[WRIST] == pytest.approx([0.0, 0.0, 0.0])


def test_flexion_of_the_base_by_90_degrees_points_the_finger_at_the_palm() -> None:
    flexed = joints(bent(middle_base_flexion=90))
    assert flexed[MIDDLE["pip"]] == pytest.approx([-2.0, 93.0, 2.0 - 44.6], abs=1e-9)
    assert flexed[MIDDLE["tip"]] == pytest.approx([-2.0, 93.0, 2.0 - 44.6 - 26.3 - 17.4], abs=1e-9)


def test_a_hook_of_two_right_angles_points_back_at_the_wrist() -> None:
    hooked = joints(bent(middle_base_flexion=90, middle_middle_flexion=90))
    assert hooked[MIDDLE["tip"]] == pytest.approx([-2.0, 93.0 - 26.3 - 17.4, 2.0 - 44.6], abs=1e-9)


def test_abduction_of_a_finger_moves_it_to_the_thumb() -> None:
    spread = joints(bent(middle_abduction=20))
    length = 44.6 + 26.3 + 17.4
    expected = [-2.0 - length * np.sin(np.deg2rad(20)), 93.0 + length * np.cos(np.deg2rad(20)), 2.0]
    assert spread[MIDDLE["tip"]] == pytest.approx(expected, abs=1e-9)


def test_the_thumb_lies_on_the_side_that_makes_a_hand_right_or_left() -> None:
    assert joints(bent())[0, 0] < -40.0
    assert joints(bent(), "left")[0, 0] > 40.0


def test_the_thumb_flexes_across_the_palm_and_abducts_away_from_it() -> None:
    thumb = joints(bent())[0]
    across = joints(bent(thumb_base_flexion=30))[0] - thumb
    assert across[0] > 20.0 and across[2] < 0.0
    assert joints(bent(thumb_abduction=25))[0, 2] < thumb[2] - 15.0


def test_the_pad_of_the_flexing_thumb_turns_to_the_fingers() -> None:
    def pad(angles_rad: Array) -> Array:
        return -finger_frames(SKELETON, HandPose("right", np.eye(4), angles_rad))[0, 6, :3, 2]

    to_fingers = np.array([0.0, 0.0, 1.0])  # the index finger meets the thumb from the back of the hand
    opposed = bent(thumb_base_flexion=30, thumb_abduction=20)
    assert pad(opposed) @ to_fingers > pad(bent()) @ to_fingers + 0.15


def test_other_fingers_stay_when_one_moves() -> None:
    moved = joints(bent(index_base_flexion=70, index_middle_flexion=40))
    changed = np.abs(moved - joints(bent())).max(axis=1) > 1e-9
    assert [JOINT_NAMES[j] for j in np.flatnonzero(changed)] == ["index_tip", "index_dip", "index_pip"]


def test_the_hollow_of_the_hand_deepens_with_ring_and_little_finger_only() -> None:
    moved = joints(np.deg2rad(np.tile([0.0, 90.0, 0.0, 0.0], 5))) - joints(bent())
    sink = {finger: -moved[4 * i + 3, 2] for i, finger in enumerate(FINGERS)}
    assert sink["index"] == sink["middle"] == 0.0
    assert 8.0 < sink["ring"] < 14.0 < sink["pinky"] < 24.0


@settings(max_examples=60, deadline=None, derandomize=True)
@given(angles, hands, st.integers(0, 99))
def test_bones_keep_their_length_in_every_pose(angles_rad: Array, hand: Hand, seed: int) -> None:
    posed = forward_kinematics(SKELETON, HandPose(hand, turned(seed), angles_rad))
    assert np.abs(bone_lengths_mm(posed) - SKELETON.bone_lengths_mm).max() < 1e-9


@settings(max_examples=60, deadline=None, derandomize=True)
@given(angles, hands, st.integers(0, 99))
def test_mirroring_mirrors_joints_exactly_and_twice_is_nothing(angles_rad: Array, hand: Hand, seed: int) -> None:
    pose = HandPose(hand, turned(seed), angles_rad)
    other = mirrored(pose)
    assert other.hand != hand
    expected = forward_kinematics(SKELETON, pose) * np.diag(MIRROR)[:3]
    assert (forward_kinematics(SKELETON, other) == expected).all()
    again = mirrored(other)
    assert again.hand == hand and again.T_world_from_wrist.tobytes() == pose.T_world_from_wrist.tobytes()
    assert transforms.reason_not_rigid(other.T_world_from_wrist) is None


@settings(max_examples=60, deadline=None, derandomize=True)
@given(angles)
def test_clamping_reaches_the_limits_and_changes_nothing_within(angles_rad: Array) -> None:
    clamped = clamp_to_limits(angles_rad)
    assert is_within_limits(clamped)
    within = (JOINT_LIMITS_RAD[:, 0] <= angles_rad) & (angles_rad <= JOINT_LIMITS_RAD[:, 1])
    assert (clamped == angles_rad)[within].all()
    assert is_within_limits(angles_rad) == bool(within.all() or np.abs(clamped - angles_rad).max() <= 1e-9)


@pytest.mark.parametrize(
    ("name", "low_deg", "high_deg"),
    [
        ("index_abduction", -20, 20),
        ("pinky_base_flexion", -20, 90),
        ("ring_middle_flexion", 0, 110),
        ("middle_distal_flexion", 0, 80),
        ("thumb_distal_flexion", -15, 80),
    ],
)
def test_limits_are_those_of_goniometry(name: str, low_deg: float, high_deg: float) -> None:
    assert np.rad2deg(JOINT_LIMITS_RAD[ANGLE_NAMES.index(name)]) == pytest.approx([low_deg, high_deg])
    over = clamp_to_limits(bent(**{name: high_deg + 30.0}))
    assert np.rad2deg(over[ANGLE_NAMES.index(name)]) == pytest.approx(high_deg)


def test_many_instants_are_as_many_single_ones() -> None:
    generator = np.random.default_rng(1)
    many = generator.uniform(*JOINT_LIMITS_RAD.T, size=(2, 3, NUM_ANGLES))
    places = np.stack([[turned(3 * i + j) for j in range(3)] for i in range(2)])
    together = forward_kinematics(SKELETON, HandPose("left", places, many))
    assert together.shape == (2, 3, 21, 3)
    alone = forward_kinematics(SKELETON, HandPose("left", places[1, 2], many[1, 2]))
    assert together[1, 2] == pytest.approx(alone, abs=1e-9)


def test_frames_carry_the_joints_and_halve_the_bend() -> None:
    angles_rad = bent(middle_base_flexion=80, middle_middle_flexion=100)
    frames = finger_frames(SKELETON, HandPose("right", np.eye(4), angles_rad))[2]
    flexion_deg = np.rad2deg(np.arctan2(-frames[:, 2, 1], frames[:, 1, 1]))
    assert flexion_deg == pytest.approx([0, 40, 80, 130, 180, 180, 180], abs=1e-6)
    assert frames[2::2, :3, 3] == pytest.approx(joints(angles_rad)[[11, 10, 9]], abs=1e-9)


def test_proportions_are_those_of_adults() -> None:
    lengths = SKELETON.bone_lengths_mm
    assert lengths[[8, 9, 10]] == pytest.approx([17.4, 26.3, 44.6])  # middle finger: tip, middle, base
    assert 90.0 < lengths[ROOT] < 100.0  # wrist to middle MCP: half the hand
    straight = joints(bent())
    assert np.linalg.norm(straight[MIDDLE["tip"]]) == pytest.approx(181.3, abs=0.1)  # the pad's flesh adds the rest
    assert HandSkeleton.average(94.0).bone_lengths_mm == pytest.approx(lengths / 2)


@pytest.mark.parametrize("wrong", [lambda: HandPose("right", np.eye(4), np.zeros(19))])
def test_a_pose_of_the_wrong_size_is_refused(wrong: Callable[[], HandPose]) -> None:
    with pytest.raises(TypeError, match="angles_rad"):
        wrong()
