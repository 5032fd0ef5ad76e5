import numpy as np
import pytest

from assemblyhands_core.hands.joints import BONES
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, bone_lengths_mm, forward_kinematics
from assemblyhands_core.hands.steadiness import bones_spread_mm, robust_sd

HAND_MM = forward_kinematics(HandSkeleton.average(), HandPose("right", np.eye(4), np.zeros(20)))


def test_the_robust_deviation_is_that_of_a_normal_distribution_and_outliers_do_not_enter() -> None:
    assert robust_sd(np.array([1.0, 2.0, 3.0, 4.0, 1e6])) == pytest.approx(1.4826)
    assert robust_sd(np.random.default_rng(0).normal(scale=3.0, size=20_000)) == pytest.approx(3.0, rel=0.03)
    assert np.isnan(robust_sd(np.empty(0)))


def test_spread_is_the_mean_over_bones_and_unknown_joints_do_not_count() -> None:
    sizes = np.array([0.9, 1.0, 1.1])
    joints = sizes[:, None, None] * HAND_MM
    expected = 1.4826 * 0.1 * bone_lengths_mm(HAND_MM)
    assert bones_spread_mm(joints) == pytest.approx(expected.mean())
    tip, _ = BONES[0]
    joints[:, tip] = np.nan
    assert bones_spread_mm(joints) == pytest.approx(expected[1:].mean())
    assert np.isnan(bones_spread_mm(np.full((3, 21, 3), np.nan)))
    turned = joints[:, :, ::-1] + np.array([5.0, 6.0, 7.0])
    assert bones_spread_mm(turned) == pytest.approx(bones_spread_mm(joints))
