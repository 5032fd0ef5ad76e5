"""Rigid transforms."""

import numpy as np
import pytest

from assemblyhands_core.geometry import transforms

QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_apply_rotates_then_translates() -> None:
    transform = transforms.rigid(QUARTER_TURN, np.array([10.0, 20.0, 30.0]))
    mapped = transforms.apply(transform, np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(mapped, [[8.0, 21.0, 33.0], [10.0, 20.0, 30.0]])


def test_inverse_undoes() -> None:
    transform = transforms.rigid(QUARTER_TURN, np.array([10.0, 20.0, 30.0]))
    np.testing.assert_allclose(transforms.inverse(transform) @ transform, np.eye(4), rtol=0, atol=1e-14)


def test_apply_keeps_single_precision() -> None:
    mapped = transforms.apply(np.eye(4), np.zeros((5, 3), np.float32))
    assert mapped.dtype == np.float32 and mapped.shape == (5, 3)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({(0, 0): 0.1}, "not orthonormal"),
        ({(0, 3): np.nan}, "NaN or infinity"),
        ({(3, 0): 0.5}, "last row"),
        ({(2, 2): -1.0}, "mirror image"),
    ],
)
def test_what_is_not_rigid_gets_a_reason(change: dict[tuple[int, int], float], reason: str) -> None:
    transform = transforms.rigid(QUARTER_TURN, np.ones(3))
    assert transforms.reason_not_rigid(transform) is None
    for place, value in change.items():
        transform[place] = value
    assert reason in str(transforms.reason_not_rigid(transform))


def test_wrong_shape_is_not_rigid() -> None:
    assert "(3, 4)" in str(transforms.reason_not_rigid(np.eye(4)[:3]))


def test_rotation_error_is_judged_at_its_bound() -> None:
    nearly, off = np.eye(4), np.eye(4)
    nearly[0, 1], off[0, 1] = 0.9e-5, 1.1e-5
    assert transforms.reason_not_rigid(nearly) is None
    assert transforms.reason_not_rigid(off) is not None
