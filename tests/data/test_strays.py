"""Joints too far from their hand are taken back, and nothing else is."""

import numpy as np

from assemblyhands_core.data.strays import OUTSIDE_HAND, without_strays
from assemblyhands_core.geometry.triangulation import Triangulation
from assemblyhands_core.hands.joints import NUM_JOINTS


def _found(points: np.ndarray) -> Triangulation:
    """Of whole hands (hand, joint, 3), seen by two views; NaN is missing."""
    flat = points.reshape(-1, 3)
    is_there = np.isfinite(flat).all(axis=1)
    inlier = np.repeat(is_there[:, None], 2, axis=1)
    return Triangulation(flat, inlier, np.where(inlier, 0.5, np.nan), np.where(is_there, "ok", "too_few_views"))


def _hands(count: int) -> np.ndarray:
    """Straight hands: joint k lies 5 k mm along x, so that the middle is joint 10."""
    hands = np.zeros((count, NUM_JOINTS, 3))
    hands[..., 0] = 5.0 * np.arange(NUM_JOINTS)
    return hands


def test_a_joint_farther_than_told_is_taken_back_and_one_as_far_as_told_stays() -> None:
    hands = _hands(3)
    hands[1, 20] = [50.0, 250.0, 0.0]  # the middle stays at x = 50, y = 0
    hands[2, 20] = [50.0, 250.1, 0.0]
    found = without_strays(_found(hands), 250.0)
    is_stray = np.zeros((3, NUM_JOINTS), dtype=bool)
    is_stray[2, 20] = True
    np.testing.assert_array_equal(found.status.reshape(3, -1), np.where(is_stray, OUTSIDE_HAND, "ok"))
    np.testing.assert_array_equal(found.points_world_mm, np.where(is_stray[..., None], np.nan, hands).reshape(-1, 3))
    assert not found.valid[-1] and found.valid.sum() == 3 * NUM_JOINTS - 1


def test_each_hand_has_a_middle_of_its_own() -> None:
    hands = _hands(2) + np.array([[[0.0, 0.0, 0.0]], [[4000.0, 0.0, 0.0]]])
    assert without_strays(_found(hands), 60.0).valid.all()  # 50 mm from the middle to either end
    assert without_strays(_found(hands), 40.0).valid.sum() == 2 * 17  # joints 2 to 18


def test_missing_joints_keep_their_reason_and_hands_without_any_are_no_trouble() -> None:
    hands = _hands(2)
    hands[0, :18], hands[1] = np.nan, np.nan
    hands[0, 20, 1] = 1000.0  # of joints 18, 19 and 20 the middle is at y = 0
    found = without_strays(_found(hands), 250.0)
    assert found.status.tolist() == ["too_few_views"] * 18 + ["ok"] * 2 + [OUTSIDE_HAND] + ["too_few_views"] * 21
    np.testing.assert_array_equal(found.points_world_mm[18:20], hands[0, 18:20])
