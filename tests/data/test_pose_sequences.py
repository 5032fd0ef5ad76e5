"""Inputs of verb classification: length, origin, scale, and the reference's own preparation to the bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.assembly101_poses import Assembly101Poses
from assemblyhands_core.data.fine_grained import VERBS, read_fine_grained
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import (
    REFERENCE,
    WRIST_NODE,
    PoseSequenceConfig,
    build_sequence,
    reference_tracks,
    segment_clip,
    sequence_of,
)
from assemblyhands_core.data.verb_segments import VerbSegment, VerbSelection, select_verb_segments
from assemblyhands_core.hands.joints import BONES, WRIST

PLAIN = PoseSequenceConfig(
    rate_hz=30, context_keys=0, num_frames=8, length="pad", centre="none", scale="none", graph="skeleton"
)


def _clip(count: int, unseen: tuple[int, ...] = ()) -> PoseClip:
    """Every node of hand h at instant i is at (i, h, 0) times 10 mm, but for node 0, which is 1 m off."""
    nodes = np.zeros((count, 2, 21, 3), dtype=np.float32)
    nodes[..., 0] = 10 * np.arange(count)[:, None, None]
    nodes[:, 1, :, 1] = 10
    nodes[:, :, 0, 2] = 1000
    observed = np.ones((count, 2), dtype=bool)
    for hand in unseen:
        nodes[:, hand], observed[:, hand] = np.nan, False
    return PoseClip(nodes, observed, np.zeros((count, 2), dtype=bool), "skeleton")


def test_the_reference_is_reproduced_exactly(golden_dir: Path, tmp_path: Path) -> None:
    golden = np.load(golden_dir / "msg3d_preprocess.npz", allow_pickle=False)
    names = [str(name) for name in golden["video_names"]]
    poses = {name: Assembly101Poses(golden[f"poses_{i}"], golden[f"confidence_{i}"]) for i, name in enumerate(names)}
    for split, count in (("train", 9), ("validation", 5)):
        (tmp_path / "labels.csv").write_text(str(golden[f"csv_{split}"]))
        found = read_fine_grained(tmp_path / "labels.csv")
        keys = {name: range(len(of_recording)) for name, of_recording in poses.items()}
        segments = select_verb_segments(found, VerbSelection(verbs=VERBS), keys).segments
        clips = [segment_clip(reference_tracks(poses[s.recording]), s, REFERENCE) for s in segments]
        values = np.stack([sequence_of(clip, REFERENCE).values for clip in clips])
        assert len(segments) == count and values.dtype == np.float32
        np.testing.assert_array_equal(values, golden[f"data_{split}"])
        described = [str(name).split("_") for name in golden[f"sample_name_{split}"]]
        assert [int(words[2][1:]) for words in described] == [VERBS.index(s.verb) for s in segments]
        assert [int(words[4][3:]) for words in described] == [len(clip) for clip in clips]


def test_the_reference_on_joints_of_ours(golden_dir: Path) -> None:
    """Through our order of hands and joints and back, all is the same but the palm, which has no place in it."""
    golden = np.load(golden_dir / "msg3d_preprocess.npz", allow_pickle=False)
    poses = Assembly101Poses(golden["poses_0"], golden["confidence_0"])
    joints, valid = poses.joints()
    segment = VerbSegment("r", 0, "pick up", "", 100, 150)
    built = build_sequence(joints, valid, np.arange(len(poses)) / 60, segment, REFERENCE)
    direct = sequence_of(segment_clip(reference_tracks(poses), segment, REFERENCE), REFERENCE)
    np.testing.assert_array_equal(built.values[:, :, :20], direct.values[:, :, :20])
    assert built.num_frames == 101 and built.observed[:101].all() and not built.observed[101:].any()


def test_wrists_of_both_graphs() -> None:
    assert WRIST_NODE == {"skeleton": WRIST, "landmarks": 5}


def test_padding_keeps_the_beginning_and_adds_zeros() -> None:
    short, long = sequence_of(_clip(5), PLAIN), sequence_of(_clip(11), PLAIN)
    np.testing.assert_array_equal(short.values[0, :, 7, 1], [0, 10, 20, 30, 40, 0, 0, 0])
    np.testing.assert_array_equal(short.values[1, :, 7], [[0, 10]] * 5 + [[0, 0]] * 3)
    np.testing.assert_array_equal(short.observed[:, 0], [True] * 5 + [False] * 3)
    np.testing.assert_array_equal(long.values[0, :, 7, 0], np.arange(8) * 10)
    assert (short.num_frames, long.num_frames) == (5, 8)
    assert short.values.shape == (3, 8, 21, 2) and short.values.dtype == np.float32


def test_resampling_shows_the_whole_clip() -> None:
    stretched, squeezed = (sequence_of(_clip(n), replace(PLAIN, length="resample")) for n in (3, 15))
    np.testing.assert_allclose(stretched.values[0, :, 7, 0], np.linspace(0, 20, 8), rtol=1e-6)
    np.testing.assert_allclose(squeezed.values[0, :, 7, 0], np.arange(8) * 20, rtol=1e-6)
    assert stretched.num_frames == squeezed.num_frames == 8 and stretched.observed.all()


def test_fitting_keeps_the_speed_of_short_clips_and_the_end_of_long_ones() -> None:
    fit, padded = replace(PLAIN, length="fit"), replace(PLAIN, length="pad")
    np.testing.assert_array_equal(sequence_of(_clip(5), fit).values, sequence_of(_clip(5), padded).values)
    np.testing.assert_array_equal(sequence_of(_clip(8), fit).values, sequence_of(_clip(8), padded).values)
    np.testing.assert_allclose(sequence_of(_clip(15), fit).values[0, :, 7, 0], np.arange(8) * 20, rtol=1e-6)


def test_one_origin_amid_both_wrists() -> None:
    centred = sequence_of(_clip(5), replace(PLAIN, centre="segment"))
    np.testing.assert_array_equal(centred.values[0, :5, WRIST, 0], [-20, -10, 0, 10, 20])  # how the wrist moves stays
    np.testing.assert_array_equal(centred.values[1, :5, WRIST], [[-5, 5]] * 5)  # and how the hands stand to each other
    assert not centred.values[:, 5:].any()  # padding is zero, not minus the origin
    alone = sequence_of(_clip(5, unseen=(0,)), replace(PLAIN, centre="segment"))
    np.testing.assert_array_equal(alone.values[1, :5, WRIST], [[0, 0]] * 5)
    assert not alone.values[..., 0].any() and not alone.observed[:, 0].any()


def test_the_origin_is_that_of_the_whole_clip() -> None:
    centred = sequence_of(_clip(11), replace(PLAIN, centre="segment"))
    np.testing.assert_array_equal(centred.values[0, :, WRIST, 0], np.arange(-50, 30, 10))


def test_every_hand_from_its_wrist() -> None:
    centred = sequence_of(_clip(5), replace(PLAIN, centre="wrist"))
    assert not centred.values[:, :, 1:].any()
    np.testing.assert_array_equal(centred.values[:, :5, 0].transpose(1, 2, 0), [[[0, 0, 1000]] * 2] * 5)


def _hand(bone_mm: float) -> np.ndarray:
    """Return a hand all of whose bones are equally long."""
    joints = np.zeros((21, 3), dtype=np.float32)
    for child, parent in sorted(BONES, key=lambda bone: -bone[0]):
        joints[child] = joints[parent] + [bone_mm, 0, 0]
    return joints


def test_the_scale_is_the_hands_mean_bone_and_robust() -> None:
    nodes = np.tile(_hand(40.0), (7, 2, 1, 1))
    nodes[3, 0] *= 50  # an estimate that went wrong
    clip = PoseClip(nodes, np.ones((7, 2), dtype=bool), np.zeros((7, 2), dtype=bool), "skeleton")
    scaled = sequence_of(clip, replace(PLAIN, scale="bones")).values
    np.testing.assert_allclose(scaled[:, :7], (nodes / 40).transpose(3, 0, 2, 1), rtol=1e-6)
    tiny = PoseClip(nodes / 1000, clip.observed, clip.is_interpolated, "skeleton")  # no hand is so small
    np.testing.assert_allclose(sequence_of(tiny, replace(PLAIN, scale="bones")).values[0, 0, 19, 0], 0.04 / 15)


def test_the_scale_is_of_what_was_observed() -> None:
    """Poses put between others are shorter than hands are where fingers bend on the way."""
    observed = np.arange(7) < 2
    nodes = np.where(observed[:, None, None, None], _hand(40.0), _hand(30.0)) * np.ones((7, 2, 1, 1))
    flags = np.stack([observed] * 2, axis=1)
    scaled = sequence_of(PoseClip(nodes.astype(np.float32), flags, ~flags, "skeleton"), replace(PLAIN, scale="bones"))
    assert scaled.values[0, 0, 19, 0] == pytest.approx(1.0)


def test_hands_of_any_size_are_alike() -> None:
    config = replace(PLAIN, centre="segment", scale="bones")
    clips = [replace(_clip(5), nodes_mm=np.tile(_hand(bone), (5, 2, 1, 1))) for bone in (30.0, 45.0)]
    small, large = (sequence_of(clip, config).values for clip in clips)
    np.testing.assert_allclose(small, large, rtol=1e-6)


def test_without_poses_there_are_zeros() -> None:
    segment = VerbSegment("r", 0, "screw", "", 600, 660)
    config = replace(PLAIN, length="resample", centre="segment", scale="bones")
    built = build_sequence(np.zeros((5, 42, 3)), np.ones((5, 42), dtype=bool), np.arange(5) / 30, segment, config)
    unknown = build_sequence(
        np.zeros((99, 42, 3)),
        np.zeros((99, 42), dtype=bool),
        np.arange(99) / 30,
        replace(segment, first_key=20),
        config,
    )
    for sequence in (built, unknown):
        assert not sequence.values.any() and not sequence.observed.any() and not sequence.is_interpolated.any()
    assert (built.num_frames, unknown.num_frames) == (0, 8)


def test_what_makes_no_sequence() -> None:
    with pytest.raises(ValueError, match="num_frames=0"):
        replace(PLAIN, num_frames=0)
    with pytest.raises(ValueError, match="name right and left"):
        replace(PLAIN, hands=("left", "left"))
    with pytest.raises(ValueError, match="graph 'skeleton', the network takes 'landmarks'"):
        sequence_of(_clip(3), replace(PLAIN, graph="landmarks"))
