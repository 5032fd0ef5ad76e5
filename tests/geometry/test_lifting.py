"""Lifting 2.5D to 3D: exact where everything is known, and the depth from the size of the hand."""

import numpy as np
import pytest

from assemblyhands_core.geometry.lifting import FARTHEST_MM, lifted_mm, wrist_depth_of_size_mm
from assemblyhands_core.hands.joints import BONES, WRIST
from assemblyhands_core.hands.kinematics import bone_lengths_mm

INTRINSICS_PX = np.array([[400.0, 380.0, 63.5, 60.0], [250.0, 260.0, 70.0, 63.5]])


def _hands() -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.normal(scale=40.0, size=(2, 21, 3)) + np.array([[[30.0, -20.0, 400.0]], [[-50.0, 10.0, 900.0]]])


def _seen(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels and depth beyond the wrist, by the pinhole's formula."""
    fx, fy, cx, cy = INTRINSICS_PX.T[..., None]
    x, y, z = joints.transpose(2, 0, 1)
    return np.stack([fx * x / z + cx, fy * y / z + cy], axis=-1), z - z[:, [WRIST]]


def test_a_joint_on_the_axis_and_one_beside_it_by_hand() -> None:
    pixels = np.tile([[63.5, 60.0]], (1, 21, 1))
    pixels[0, 3] = [63.5 + 40.0, 60.0 - 19.0]  # a tenth and a twentieth of the focal lengths
    depth_mm = np.zeros((1, 21))
    depth_mm[0, 3] = 100.0
    found = lifted_mm(pixels, depth_mm, np.array([400.0]), INTRINSICS_PX[:1])
    np.testing.assert_allclose(found[0, 0], [0.0, 0.0, 400.0], atol=1e-12)
    np.testing.assert_allclose(found[0, 3], [50.0, -25.0, 500.0], atol=1e-12)


def test_what_a_camera_saw_is_lifted_to_where_it_was() -> None:
    joints = _hands()
    pixels, depth_mm = _seen(joints)
    found = lifted_mm(pixels, depth_mm, joints[:, WRIST, 2], INTRINSICS_PX)
    np.testing.assert_allclose(found, joints, rtol=0, atol=1e-9)


def test_the_size_of_a_hand_tells_its_depth() -> None:
    joints = _hands()
    pixels, depth_mm = _seen(joints)
    for index in (0, 1):
        size_mm = float(bone_lengths_mm(joints[index]).sum())
        found = wrist_depth_of_size_mm(
            *(a[index : index + 1] for a in (pixels, depth_mm, INTRINSICS_PX)), BONES, size_mm
        )
        assert found[0] == pytest.approx(joints[index, WRIST, 2], abs=1e-6)


def test_a_hand_that_is_larger_than_it_looks_is_farther_away() -> None:
    pixels, depth_mm = _seen(_hands())
    near, far = (wrist_depth_of_size_mm(pixels, 0 * depth_mm, INTRINSICS_PX, BONES, size) for size in (500.0, 1000.0))
    np.testing.assert_allclose(far, 2 * near, rtol=1e-9)  # without depth of its own a hand scales with the distance
    beyond = wrist_depth_of_size_mm(pixels, depth_mm, INTRINSICS_PX, BONES, 1e7)
    np.testing.assert_allclose(beyond, FARTHEST_MM, rtol=1e-9)


def test_a_missing_joint_leaves_the_depth_unknown_for_its_hand_alone() -> None:
    joints = _hands()
    pixels, depth_mm = _seen(joints)
    pixels[0, 5] = np.nan
    found = wrist_depth_of_size_mm(pixels, depth_mm, INTRINSICS_PX, BONES, float(bone_lengths_mm(joints[1]).sum()))
    assert np.isnan(found[0]) and found[1] == pytest.approx(joints[1, WRIST, 2], abs=1e-6)
