"""Clips go into rows and come out of them as they were; tracks cover the video."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from verb_clips import clip_table, moving_clip, unseen_clip

from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.pose_clips import PoseClip, cut_clip
from assemblyhands_core.data.verb_clip_rows import clips_of, tracks_of_joints
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.hands.graphs import graph_nodes
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS

POINTS = np.random.default_rng(0).normal(0, 50, (4, 2, NUM_JOINTS, 3)).astype(np.float32)  # frame, hand


def _joints(frames: list[int], hands: tuple[str, ...] = HANDS, **changes: Any) -> pa.Table:
    rows = [
        {
            "sequence_id": "s",
            "frame": frame,
            "hand": hand,
            "joints_world_mm": POINTS[frame % 4, HANDS.index(hand)].ravel(),  # type: ignore[arg-type]
            "valid": np.ones(NUM_JOINTS, dtype=bool),
            "reason": [""] * NUM_JOINTS,
            "num_views": np.full(NUM_JOINTS, 2),
            "reprojection_px": np.zeros(NUM_JOINTS),
            "source": "test",
            "round": 3,
            **changes,
        }
        for frame in frames
        for hand in hands
    ]
    return JOINTS.from_rows(rows)


def _assert_equal(one: PoseClip, other: PoseClip) -> None:
    for name in ("nodes_mm", "observed", "is_interpolated"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.graph == other.graph


def test_clips_come_back_whatever_their_length() -> None:
    whole, unseen, beside = moving_clip("screw", 1), unseen_clip(), moving_clip("remove", 2, "landmarks")
    gap = np.ones((16, 2), dtype=bool)
    gap[3:5, 1] = False
    holed = PoseClip(whole.nodes_mm, gap, ~gap, whole.graph)
    short = PoseClip(whole.nodes_mm[:1], gap[:1], ~gap[:1], whole.graph)
    clips = [whole, short, unseen, holed, beside]
    table = clip_table("s", ["screw"] * len(clips), clips, rate_hz=15)
    assert table.num_rows == 4 * 16 + 1
    shuffled = table.take(np.random.default_rng(0).permutation(table.num_rows))
    for rows in (table, shuffled, pa.concat_tables([table.slice(40), table.slice(0, 40)])):
        for number, ((segment, found), clip) in enumerate(zip(clips_of(rows), clips, strict=True)):
            assert segment == VerbSegment("s", number, "screw", "bolt", 100 * number, 100 * number + 31)
            _assert_equal(found, clip)
    assert clips_of(VERB_CLIPS.empty()) == []


def test_clips_of_several_sequences_stay_apart() -> None:
    tables = [clip_table(name, ["screw"], [moving_clip("screw", number)]) for number, name in enumerate("ba")]
    (first, of_a), (second, of_b) = clips_of(pa.concat_tables(tables))
    assert (first.recording, second.recording) == ("a", "b")
    _assert_equal(of_a, moving_clip("screw", 1))
    _assert_equal(of_b, moving_clip("screw", 0))


def test_joints_become_tracks_by_hand_and_time() -> None:
    joints = _joints([2, 0, 3])
    tracks = tracks_of_joints(joints, 4, keys_per_frame=6, first_key=30, graph="skeleton")
    np.testing.assert_allclose(tracks.times_s, [0.5, 0.7, 0.8])  # keys 30, 42, 48
    np.testing.assert_array_equal(tracks.nodes_mm, POINTS[[0, 2, 3]])
    other = tracks_of_joints(joints, 4, 6, 30, "landmarks")
    np.testing.assert_array_equal(other.nodes_mm, graph_nodes(POINTS[[0, 2, 3]].astype(np.float64), "landmarks"))


def test_joints_that_are_not_valid_are_not_there() -> None:
    is_valid = np.arange(NUM_JOINTS) != 7
    tracks = tracks_of_joints(_joints([0, 1], ("left",), valid=is_valid), 2, 2, 0, "skeleton")
    assert np.isnan(tracks.nodes_mm[:, 0]).all() and np.isnan(tracks.nodes_mm[:, 1, 7]).all()
    np.testing.assert_array_equal(tracks.nodes_mm[:, 1, is_valid], POINTS[:2, 1][:, is_valid])


def test_clips_have_the_same_instants_wherever_poses_begin_and_end() -> None:
    """So that errors are between poses of one instant: each source knows other frames."""
    for frames in ([0, 1, 2, 3, 4, 5], [2, 3], [], [5]):
        tracks = tracks_of_joints(_joints(frames), 6, keys_per_frame=2, first_key=0, graph="skeleton")
        clip = cut_clip(tracks, 2, 9, rate_hz=30, context_keys=25)
        seen = np.isin(np.arange(6), frames)
        np.testing.assert_array_equal(clip.observed, np.stack([seen, seen], axis=1))


def test_two_rounds_are_refused() -> None:
    both = pa.concat_tables([_joints([0, 1]), _joints([1], round=2)])
    with pytest.raises(ValueError, match=r"joints of rounds \[2, 3\] stand beside each other; give those of one"):
        tracks_of_joints(both, 2, 2, 0, "skeleton")
