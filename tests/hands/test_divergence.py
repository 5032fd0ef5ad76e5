"""The guard of refinement, each limit from both sides."""

import dataclasses

import numpy as np
import pytest

from assemblyhands_core.hands.divergence import Course, Limits, Step, divergence, unsteadiness
from assemblyhands_core.hands.joints import ROOT, WRIST
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, forward_kinematics

LIMITS = Limits(
    max_displacement_mm=50.0,
    max_body_distance_mm=120.0,
    min_size=0.8,
    max_size=1.25,
    max_bone_mm=120.0,
    max_reprojection_ratio=2.0,
    max_spread_ratio=1.25,
    max_course_px_ratio=1.5,
    min_instants=2,
    min_reprojection_px=10.0,
    min_view_share=0.5,
)
HAND_MM = forward_kinematics(HandSkeleton.average(), HandPose("right", np.eye(4), np.zeros(20)))
ROOT_MM, WRIST_MM = HAND_MM[ROOT], HAND_MM[WRIST]
NOWHERE = np.full(3, np.nan)
QUIET = Step(HAND_MM, ROOT_MM, WRIST_MM, NOWHERE, NOWHERE, 1.0, 1.0, 1.0)


def _reason(**changes: object) -> str:
    found = divergence(dataclasses.replace(QUIET, **changes), LIMITS)  # type: ignore[arg-type]
    return "" if found is None else f"{found.reason}: {found.note}"


def test_a_hand_that_stays_is_believed_whatever_is_not_known() -> None:
    assert _reason() == ""
    unknown = dict.fromkeys(("reprojection_px", "previous_reprojection_px"), float("nan"))
    assert _reason(root_world_mm=NOWHERE, wrist_world_mm=NOWHERE, **unknown) == ""
    assert _reason(reprojection_px=99.0, previous_reprojection_px=float("nan")) == ""


@pytest.mark.parametrize(("name", "place"), [("root", ROOT_MM), ("wrist", WRIST_MM)])
def test_jumps_of_root_and_wrist(name: str, place: np.ndarray) -> None:
    assert _reason(**{f"{name}_world_mm": place + np.array([30.0, 41.0, 0.0])}) == f"jumped: its {name} jumped 51 mm"
    assert _reason(**{f"{name}_world_mm": place + np.array([30.0, 39.0, 0.0])}) == ""


def test_the_other_hand() -> None:
    own = ROOT_MM + np.array([20.0, 0.0, 0.0])
    near, far = ROOT_MM - np.array([0.0, 19.0, 0.0]), ROOT_MM - np.array([0.0, 21.0, 0.0])
    expected = "other_hand: 20 mm from where it was, 19 mm from the other hand"
    assert _reason(root_world_mm=own, other_root_world_mm=near) == expected
    assert _reason(root_world_mm=own, other_root_world_mm=far) == ""


def test_the_body() -> None:
    assert (
        _reason(body_center_world_mm=ROOT_MM + np.array([0.0, 0.0, 121.0])) == "left_body: 121 mm from the body's hand"
    )
    assert _reason(body_center_world_mm=ROOT_MM + np.array([0.0, 0.0, 119.0])) == ""


@pytest.mark.parametrize(("size", "is_believed"), [(0.79, False), (0.81, True), (1.24, True), (1.26, False)])
def test_sizes_of_hands(size: float, is_believed: bool) -> None:
    hand = ROOT_MM + size * (HAND_MM - ROOT_MM)
    expected = "" if is_believed else f"implausible_bones: {size:.2f} of a mean hand's size"
    assert _reason(joints_world_mm=hand) == expected


def test_one_bone_alone() -> None:
    """The middle metacarpal is 93 mm long; its finger goes with it."""
    for shift_mm, expected in ((28.0, "implausible_bones: a bone of 121 mm"), (26.0, "")):
        hand = HAND_MM.copy()
        hand[8:12] += shift_mm * (ROOT_MM - WRIST_MM) / np.linalg.norm(ROOT_MM - WRIST_MM)
        assert _reason(joints_world_mm=hand) == expected


def test_reprojection_has_to_be_both_large_and_much_larger() -> None:
    assert _reason(reprojection_px=12.1, previous_reprojection_px=6.0) == (
        "high_reprojection: 12.1 px from the 2D keypoints, before 6.0 px"
    )
    assert _reason(reprojection_px=11.9, previous_reprojection_px=6.0) == ""
    assert _reason(reprojection_px=9.9, previous_reprojection_px=1.0) == ""
    much = {"reprojection_px": 50.0, "previous_reprojection_px": 2.0}
    assert _reason(**much, previous_view_share=0.49) == "", "two views of many fit anything"
    assert _reason(**much, previous_view_share=0.5).startswith("high_reprojection")


def _course(scale: float, *pixels: float, num_instants: int = 4) -> Course:
    """A hand that alternates between two sizes, scale apart; in 2D + triangulation it alternates by one per cent."""
    sizes = np.resize([1.0, scale], num_instants), np.resize([1.0, 1.01], num_instants)
    return Course(*(size[:, None, None] * HAND_MM for size in sizes), *pixels)


def test_a_hand_whose_bones_vary_more_is_less_believed_only_if_it_fits_its_keypoints_worse_too() -> None:
    found = unsteadiness(_course(1.02, 6.1, 4.0), LIMITS)
    assert found is not None and found.reason == "unsteady" and "6.1 px from the 2D keypoints, 4.0 px" in found.note
    assert unsteadiness(_course(1.02, 5.9, 4.0), LIMITS) is None, "fits hardly worse"
    assert unsteadiness(_course(1.0124, 6.1, 4.0), LIMITS) is None, "varies hardly more"
    assert unsteadiness(_course(1.0126, 6.1, 4.0), LIMITS) is not None
    assert unsteadiness(_course(1.02, 6.1, 4.0, num_instants=1), LIMITS) is None, "nothing to vary"
    assert unsteadiness(_course(1.02, float("nan"), 4.0), LIMITS) is None, "no keypoints"


def test_only_instants_count_that_both_know() -> None:
    """In 2D + triangulation the hand is known at the easy instants alone: there the new one varies as little."""
    course = _course(1.01, 9.0, 4.0, num_instants=8)
    course.joints_world_mm[4:] *= 1.5
    assert unsteadiness(course, LIMITS) is not None
    course.triangulated_world_mm[4:] = np.nan
    assert unsteadiness(course, LIMITS) is None
