"""Poses of mounted cameras against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.mounts import disturbed, look_at, spherical

UP = np.array([0.0, 1.0, 0.0])


def test_look_along_minus_z_from_two_metres() -> None:
    pose = look_at(np.array([0.0, 0.0, 2000.0]), np.zeros(3), UP)
    # The world's x is to the right, its y up (image -y), and the origin lies 2 m ahead.
    assert np.abs(pose - [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 2000], [0, 0, 0, 1]]).max() < 1e-12


def test_roll_is_clockwise_from_behind() -> None:
    pose = look_at(np.array([0.0, 0.0, 2000.0]), np.zeros(3), UP, np.pi / 2)
    # A camera turned clockwise has its right hand side down: what is on the world's right appears at the image's top.
    assert np.abs(pose[:3, :3] @ [1.0, 0.0, 0.0] - [0.0, -1.0, 0.0]).max() < 1e-12


@given(azimuth=st.floats(-180, 180), elevation=st.floats(-80, 80), roll=st.floats(-3, 3), distance=st.floats(10, 5000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_target_is_on_the_axis_and_the_pose_rigid(
    azimuth: float, elevation: float, roll: float, distance: float
) -> None:
    target = np.array([80.0, 190.0, 80.0])
    pose = look_at(target + distance * spherical(azimuth, elevation), target, UP, roll)
    assert transforms.reason_not_rigid(pose) is None
    assert np.abs(transforms.apply(pose, target) - [0, 0, distance]).max() < 1e-8


def test_no_pose_along_up() -> None:
    with pytest.raises(ValueError, match="choose another up"):
        look_at(np.array([0.0, 1000.0, 0.0]), np.zeros(3), UP)
    with pytest.raises(ValueError, match="choose another up"):
        look_at(np.zeros(3), np.zeros(3), UP)


def test_spherical_directions() -> None:
    assert np.abs(spherical(0, 0) - [1, 0, 0]).max() < 1e-15
    assert np.abs(spherical(90, 0) - [0, 0, 1]).max() < 1e-15
    assert np.abs(spherical(90, 30) - [0, 0.5, np.sqrt(0.75)]).max() < 1e-15


@given(seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_disturbance_stays_in_its_bounds(seed: int) -> None:
    pose = look_at(np.array([300.0, 400.0, 500.0]), np.zeros(3), UP)
    moved = disturbed(pose, 3.0, 2.0, np.random.default_rng(seed))
    shift_mm = transforms.inverse(moved)[:3, 3] - [300.0, 400.0, 500.0]
    turn = np.arccos(np.clip((np.trace(moved[:3, :3] @ pose[:3, :3].T) - 1) / 2, -1, 1))
    assert 0 < np.abs(shift_mm).max() <= 3 + 1e-9
    assert np.degrees(turn) <= 2 + 1e-6
    assert transforms.reason_not_rigid(moved) is None
