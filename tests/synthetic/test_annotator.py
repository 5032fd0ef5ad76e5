"""An annotator is off by as much as stated, leaves out what cannot be seen, and is the same person tomorrow."""

import numpy as np
import pyarrow as pa
import pyarrow.compute
import pytest

from assemblyhands_core.data.ground_truth import TrueInstant, ground_truth_tables
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.synthetic.annotator import JOINT_NOISE_MM, annotate, noise_mm

NAME = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
CAMERAS = ("C10095_rgb", "C10115_rgb", "C10118_rgb", "HMC_84355350_mono10bit")
NUM_FRAMES = 150


def truth(num_seeing: int) -> dict[str, pa.Table]:
    """Many frames of two hands before four cameras, of which the first ones see all joints but the wrists."""
    pose = np.eye(4)
    pose[2, 3] = 900.0
    cameras = {name: Camera(name, 640, 480, 300.0, 300.0, 319.5, 239.5, Pinhole(), pose) for name in CAMERAS}
    seen = np.ones((2, 21), dtype=bool)
    seen[:, 20] = False
    unoccluded = {name: seen & (index < num_seeing) for index, name in enumerate(CAMERAS)}
    joints = np.random.default_rng(1).uniform(-80, 80, (2, 21, 3))
    return ground_truth_tables(NAME, [TrueInstant(n, joints, cameras, unoccluded) for n in range(NUM_FRAMES)])


def labels(num_seeing: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    tables = truth(num_seeing)
    found = annotate(NAME, tables["true_joints"], tables["true_views"], range(NUM_FRAMES))
    true = np.array(tables["true_joints"]["joints_world_mm"].to_pylist()).reshape(NUM_FRAMES, 2, 21, 3)
    return found.frames_60hz, found.joints_world_mm - true, found.is_valid


def test_noise_is_as_stated() -> None:
    assert noise_mm(np.array([[8] * 21]))[0] == pytest.approx(JOINT_NOISE_MM)
    assert noise_mm(np.array([[3] * 21]))[0] == pytest.approx(np.sqrt(2) * JOINT_NOISE_MM)
    assert noise_mm(np.array([[0] * 21]))[0] == pytest.approx(np.sqrt(3) * JOINT_NOISE_MM)
    frames, errors, valid = labels(3)
    assert frames.tolist() == list(range(0, 2 * NUM_FRAMES, 2))
    assert valid[..., :20].all() and not valid[..., 20].any() and np.isnan(errors[..., 20, :]).all()
    spread = errors[..., :20, :].std(axis=(0, 1, 3))
    assert spread == pytest.approx(np.sqrt(2) * JOINT_NOISE_MM[:20], rel=0.15)


def test_a_recording_of_the_headset_alone_was_labelled_in_pictures_that_are_not_part_of_it() -> None:
    tables = truth(4)
    is_ego = pa.compute.match_substring(tables["true_views"]["camera_id"], "HMC")
    found = annotate(NAME, tables["true_joints"], tables["true_views"].filter(is_ego), range(NUM_FRAMES))
    true = np.array(tables["true_joints"]["joints_world_mm"].to_pylist()).reshape(NUM_FRAMES, 2, 21, 3)
    assert found.is_valid.all()
    spread = (found.joints_world_mm - true).std(axis=(0, 1, 3))
    assert spread == pytest.approx(JOINT_NOISE_MM, rel=0.15)


def test_what_a_single_exocentric_view_shows_is_left_out() -> None:
    assert not labels(1)[2].any()
    assert labels(2)[2][..., :20].all()


def test_the_same_frame_gets_the_same_label_whatever_else_is_labelled() -> None:
    tables = truth(3)
    whole = annotate(NAME, tables["true_joints"], tables["true_views"], range(0, NUM_FRAMES, 30))
    alone = annotate(NAME, tables["true_joints"], tables["true_views"], [60])
    seldom = annotate(NAME, tables["true_joints"], tables["true_views"], [60], rate_hz=2)
    assert alone.frames_60hz.tolist() == [120] and seldom.frames_60hz.tolist() == [1800]
    np.testing.assert_array_equal(whole.joints_world_mm[2], alone.joints_world_mm[0])
    assert alone.frames_60hz.tolist() == [120]
    assert np.abs(whole.joints_world_mm[2] - whole.joints_world_mm[1])[..., :20, :].min() > 0
