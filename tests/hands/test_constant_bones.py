import numpy as np

from assemblyhands_core.hands.constant_bones import with_constant_bones
from assemblyhands_core.hands.joints import BONES, WRIST
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, bone_lengths_mm, forward_kinematics

NUM_FRAMES = 60


def _grasp() -> np.ndarray:
    """Return a hand (F, 21, 3) that closes while it moves."""
    poses = np.repeat(np.eye(4)[None], NUM_FRAMES, axis=0)
    poses[:, :3, 3] = np.linspace([0.0, 0.0, 900.0], [300.0, 50.0, 800.0], NUM_FRAMES)
    bend = np.linspace(0.0, 1.0, NUM_FRAMES)[:, None] * np.tile([0.0, 1.2, 1.2, 0.8], 5)
    return forward_kinematics(HandSkeleton.average(), HandPose("right", poses, bend))


def _noisy(sd_mm: float) -> np.ndarray:
    return _grasp() + np.random.default_rng(0).normal(scale=sd_mm, size=(NUM_FRAMES, 21, 3))


def test_bones_become_constant_at_their_median_and_the_hand_nearer_to_the_truth() -> None:
    true, noisy = _grasp(), _noisy(3.0)
    steady = with_constant_bones(noisy)
    lengths = bone_lengths_mm(steady)
    np.testing.assert_allclose(lengths, np.broadcast_to(np.median(bone_lengths_mm(noisy), axis=0), lengths.shape))
    assert np.ptp(lengths, axis=0).max() < 1e-6 < 5.0 < np.ptp(bone_lengths_mm(noisy), axis=0).max()
    ratio = np.linalg.norm(steady - true, axis=-1).mean() / np.linalg.norm(noisy - true, axis=-1).mean()
    assert 0.7 < ratio < 0.95


def test_a_hand_whose_bones_are_constant_stays_as_it_is() -> None:
    np.testing.assert_allclose(with_constant_bones(_grasp()), _grasp(), atol=1e-9)


def test_few_wrong_instants_do_not_change_the_lengths() -> None:
    joints = _grasp()
    joints[:20, 0] += 30.0
    lengths = bone_lengths_mm(with_constant_bones(joints))
    np.testing.assert_allclose(lengths, np.broadcast_to(HandSkeleton.average().bone_lengths_mm, lengths.shape))


def test_a_bone_with_an_unknown_end_moves_nothing() -> None:
    joints = _noisy(2.0)
    joints[::2, 5] = np.nan  # the index finger's DIP
    joints[:, WRIST] = np.nan
    steady = with_constant_bones(joints)
    np.testing.assert_array_equal(np.isnan(steady), np.isnan(joints))
    np.testing.assert_array_equal(steady[::2, 4], joints[::2, 4])  # the tip hangs on nothing
    lengths = bone_lengths_mm(steady)
    is_known = np.isfinite(lengths)
    assert not is_known[:, [bone for bone, (_, parent) in enumerate(BONES) if parent == WRIST]].any()
    spread = [np.ptp(bone[known]) for bone, known in zip(lengths.T, is_known.T, strict=True) if known.any()]
    assert len(spread) == 15 and max(spread) < 1e-6


def test_no_instants_an_unseen_hand_and_joints_in_one_place() -> None:
    assert with_constant_bones(np.empty((0, 21, 3))).shape == (0, 21, 3)
    assert np.isnan(with_constant_bones(np.full((3, 21, 3), np.nan))).all()
    np.testing.assert_array_equal(with_constant_bones(np.ones((3, 21, 3))), np.ones((3, 21, 3)))
    np.testing.assert_allclose(with_constant_bones(_noisy(2.0)[:1]), _noisy(2.0)[:1], atol=1e-9)
