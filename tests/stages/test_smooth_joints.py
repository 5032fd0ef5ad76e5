"""The clean-up of a sequence: what becomes of each column, hand by hand."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, bone_lengths_mm, forward_kinematics
from assemblyhands_core.hands.steadiness import bones_spread_mm
from pipeline.dag import build_dag
from stages._contract import Context
from stages.smooth_joints import STAGE, SmoothJointsConfig

CONFIG = SmoothJointsConfig(max_gap_frames=3, cutoff_period_frames=7.0, max_deviation_sd=8.0)
NUM_FRAMES = 90


def _hands() -> np.ndarray:
    """Return both hands (F, 2, 21, 3), closing and swinging, the left one later."""
    return np.stack([_hand(0), _hand(20) - np.array([400.0, 0, 0])], axis=1)


def _hand(delay_frames: int) -> np.ndarray:
    poses = np.repeat(np.eye(4)[None], NUM_FRAMES, axis=0)
    swing = 2 * np.pi * (np.arange(NUM_FRAMES) - delay_frames) / 60
    poses[:, :3, 3] = np.stack([200 * np.sin(swing), 40 * np.cos(swing), 900 + 0 * swing], axis=1)
    bend = 0.5 * (1 - np.cos(swing))[:, None] * np.tile([0.0, 1.2, 1.2, 0.8], 5)
    return forward_kinematics(HandSkeleton.average(), HandPose("right", poses, bend))


def _joints(points: np.ndarray, reason: str = "too_few_views") -> pa.Table:
    """Return the table of round 3 with joints (F, 2, 21, 3), valid where finite."""
    valid = np.isfinite(points).all(axis=-1).reshape(-1, 21)
    count = len(points)
    return JOINTS.build(
        {
            "sequence_id": ["s"] * 2 * count,
            "frame": np.repeat(np.arange(count), 2),
            "hand": [*HANDS] * count,
            "joints_world_mm": points.reshape(-1, 63),
            "valid": valid,
            "reason": np.where(valid, "", reason),
            "num_views": np.where(valid, 4, 1),
            "reprojection_px": np.where(valid, 2.5, np.nan),
            "source": ["mvexonet"] * 2 * count,
            "round": [3] * 2 * count,
        }
    )


def _run(joints: pa.Table, config: SmoothJointsConfig = CONFIG) -> pa.Table:
    smoothed = STAGE.run(config, {"joints": joints}, Context(Path(), "s"))["joints"]
    return JOINTS.check(smoothed)


def _by_joint(table: pa.Table, name: str) -> np.ndarray:
    return to_numpy(table[name]).reshape(-1, 2, 21)


def test_joints_come_nearer_to_the_truth_and_each_hands_bones_stay_as_they_are() -> None:
    true = _hands()
    noisy = true + np.random.default_rng(0).normal(scale=3.0, size=true.shape)
    smoothed = joints_or_nan(_run(_joints(noisy))).reshape(true.shape)
    ratio = np.linalg.norm(smoothed - true, axis=-1).mean() / np.linalg.norm(noisy - true, axis=-1).mean()
    assert 0.35 < ratio < 0.6
    for hand in range(2):
        assert bones_spread_mm(smoothed[:, hand]) < 1e-3 < 1.0 < bones_spread_mm(noisy[:, hand])
        assert np.ptp(bone_lengths_mm(smoothed[:, hand]), axis=0).max() < 1e-3  # positions are stored as float32


def test_short_gaps_are_filled_and_say_so_and_long_ones_keep_their_reason() -> None:
    points = _hands()
    points[20:23, 0, 4] = points[50:54, 1, 4] = np.nan
    joints = _joints(points)
    smoothed = _run(joints)
    is_filled = _by_joint(smoothed, "valid") & ~_by_joint(joints, "valid")
    assert np.argwhere(is_filled).tolist() == [[frame, 0, 4] for frame in (20, 21, 22)]
    assert set(_by_joint(smoothed, "reason")[is_filled]) == {""}
    assert set(_by_joint(smoothed, "num_views")[is_filled]) == {0}
    assert np.isnan(_by_joint(smoothed, "reprojection_px")[is_filled]).all()
    for name in ("valid", "reason", "num_views", "reprojection_px"):
        np.testing.assert_array_equal(_by_joint(smoothed, name)[~is_filled], _by_joint(joints, name)[~is_filled])
    assert set(_by_joint(smoothed, "reason")[50:54, 1, 4]) == {"too_few_views"}
    error = np.linalg.norm(joints_or_nan(smoothed).reshape(points.shape) - _hands(), axis=-1)
    assert error[20:23, 0, 4].max() < 4.0 and np.isnan(error[50:54, 1, 4]).all()


def test_rows_keep_their_keys_and_places_and_their_order_does_not_matter() -> None:
    joints = _joints(_hands() + np.random.default_rng(0).normal(scale=3.0, size=_hands().shape))
    smoothed = _run(joints)
    assert smoothed.select(JOINTS.key).equals(joints.select(JOINTS.key))
    assert set(smoothed["source"].to_pylist()) == {"smoothed"}
    order = np.random.default_rng(1).permutation(joints.num_rows)
    assert _run(joints.take(order)).equals(smoothed.take(order))


def test_a_hand_never_seen_stays_missing_and_the_other_one_does_not_notice() -> None:
    points = _hands() + np.random.default_rng(0).normal(scale=3.0, size=_hands().shape)
    both = joints_or_nan(_run(_joints(points))).reshape(points.shape)
    points[:, 1] = np.nan
    joints = _joints(points, "no_detection")
    smoothed = _run(joints)
    assert not _by_joint(smoothed, "valid")[:, 1].any()
    assert set(_by_joint(smoothed, "reason")[:, 1].ravel()) == {"no_detection"}
    np.testing.assert_array_equal(joints_or_nan(smoothed).reshape(points.shape)[:, 0], both[:, 0])
    right_alone = joints.filter(pa.array([hand == "right" for hand in joints["hand"].to_pylist()]))
    np.testing.assert_array_equal(joints_or_nan(_run(right_alone)), both[:, 0])


def test_no_rows_and_one_frame() -> None:
    assert _run(JOINTS.empty()).num_rows == 0
    one = _hands()[:1]
    np.testing.assert_allclose(joints_or_nan(_run(_joints(one))).reshape(one.shape), one, atol=1e-3)


def test_a_hand_with_two_rows_for_an_instant_is_refused() -> None:
    joints = _joints(_hands()[:4])
    other_round = joints.set_column(
        joints.schema.get_field_index("round"), JOINTS.schema.field("round"), pa.array([2] * 8, pa.int8())
    )
    with pytest.raises(ValueError, match="frames repeat"):
        _run(pa.concat_tables([joints, other_round]))


@pytest.mark.parametrize("num_rounds", [0, 3])
def test_it_is_made_only_when_asked_for_and_the_raw_joints_stay(num_rounds: int) -> None:
    dag = build_dag(num_rounds)
    usual, with_it = ({node.name for node in dag.upto(dag.targets[name])} for name in ("annotate", "smooth"))
    assert with_it - usual == {"smoothed", "evaluation_smoothed"} and usual < with_it and f"round_{num_rounds}" in usual
    assert dag.nodes["smoothed"].inputs == {"joints": f"round_{num_rounds}.joints"}
