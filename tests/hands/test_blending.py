"""Blending against hand-worked points and the closed form of two equal, independent errors."""

import numpy as np
import pytest

from assemblyhands_core.hands.blending import blended_mm


def test_near_joints_move_and_far_unknown_ones_stay() -> None:
    joints = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [np.nan] * 3])
    others = np.array([[10.0, 0.0, 0.0], [0.0, 0.0, 10.1], [np.nan] * 3, [1.0, 1.0, 1.0]])
    found = blended_mm(joints, others, 0.4, 10.0)
    np.testing.assert_allclose(found, [[4.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [np.nan] * 3], atol=1e-12)
    np.testing.assert_array_equal(blended_mm(joints, others, 0.0, 10.0), joints)


def test_equal_halves_of_independent_errors_leave_seven_tenths() -> None:
    one, other = np.random.default_rng(0).normal(size=(2, 20_000, 3))
    errors = np.linalg.norm(blended_mm(one, other, 0.5, 100.0), axis=1).mean()
    assert errors / np.linalg.norm(one, axis=1).mean() == pytest.approx(0.5**0.5, abs=0.01)
