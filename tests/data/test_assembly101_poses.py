"""Poses of Assembly101's tracker: left hand first, another order of joints, entries that cannot be read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.assembly101_poses import (
    Assembly101Poses,
    read_assembly101_poses,
    write_assembly101_poses,
)
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.hands.graphs import graph_nodes
from assemblyhands_core.hands.joints import JOINT_NAMES


def _hand(offset: float) -> list[list[float]]:
    return [[offset + landmark, 0.5, -1.0] for landmark in range(21)]


def _entry(left: float, right: float) -> dict[str, Any]:
    return {
        "landmarks": {"0": _hand(left), "1": _hand(right)},
        "tracking_confidence": {"0": 0.25, "1": 0.75},
    }


def _written(path: Path, entries: Any) -> Path:
    path.write_text(json.dumps(entries))
    return path


def test_hands_and_landmarks_are_found_in_our_order(tmp_path: Path) -> None:
    poses = read_assembly101_poses(_written(tmp_path / "r.json", [_entry(100, 200), _entry(300, 400)]))
    assert len(poses) == 2 and poses.problems == ()
    np.testing.assert_array_equal(poses.landmarks_world_mm[:, :, 5, 0], [[105, 205], [305, 405]])  # wrists
    np.testing.assert_array_equal(poses.confidence, [[0.25, 0.75]] * 2)
    joints, valid = poses.joints()
    names = {"thumb_tip": 0, "index_tip": 1, "pinky_tip": 4, "wrist": 5, "thumb_mcp": 6, "thumb_ip": 7}
    names |= {"index_mcp": 8, "index_pip": 9, "index_dip": 10, "ring_mcp": 14, "pinky_dip": 19}
    for name, landmark in names.items():
        joint = JOINT_NAMES.index(name)
        assert (joints[0, joint, 0], joints[0, 21 + joint, 0]) == (200 + landmark, 100 + landmark), name
    cmc = JOINT_NAMES.index("thumb_cmc")
    assert np.isnan(joints[:, [cmc, 21 + cmc]]).all() and not valid[:, [cmc, 21 + cmc]].any()
    assert valid.sum() == 2 * 40


def test_our_joints_and_back_are_the_same_landmarks(tmp_path: Path) -> None:
    poses = read_assembly101_poses(_written(tmp_path / "r.json", [_entry(100, 200)]))
    joints, _ = poses.joints()
    nodes = graph_nodes(joints.reshape(-1, 2, 21, 3), "landmarks")
    np.testing.assert_array_equal(nodes[:, ::-1, :20], poses.landmarks_world_mm[:, :, :20])  # the palm centre differs


def test_uncertain_hands_are_missing_by_choice(tmp_path: Path) -> None:
    poses = read_assembly101_poses(_written(tmp_path / "r.json", [_entry(100, 200)]))
    _, valid = poses.joints(min_confidence=0.5)
    assert valid[0, :21].sum() == 20 and not valid[0, 21:].any()


def test_what_is_written_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    landmarks = rng.normal(size=(3, 2, 21, 3)).astype(np.float32)
    confidence = rng.random((3, 2)).astype(np.float32)
    landmarks[1, 0], confidence[1, 0] = np.nan, 0.0
    write_assembly101_poses(tmp_path / "r.json", Assembly101Poses(landmarks, confidence))
    read = read_assembly101_poses(tmp_path / "r.json")
    np.testing.assert_array_equal(read.landmarks_world_mm, landmarks)
    np.testing.assert_array_equal(read.confidence, confidence)


BROKEN: list[tuple[Any, str]] = [
    ([], "frame 1: expected a JSON object"),
    ({"landmarks": {}}, "lacks 'tracking_confidence'"),
    ({"landmarks": {"0": [[1, 2, 3]] * 20}, "tracking_confidence": {"0": 1}}, "expected 21x3 numbers"),
    ({"landmarks": {"0": [[1, 2, None]] * 21}, "tracking_confidence": {"0": 1}}, "expected 21x3 numbers"),
    ({"landmarks": {"1": [[1, 2, float("nan")]] * 21}, "tracking_confidence": {"1": 1}}, "holds NaN"),
    ({"landmarks": {"1": [[1, 2, 3]] * 21}, "tracking_confidence": {"0": 1}}, "lacks '1'"),
]


@pytest.mark.parametrize(("entry", "reason"), BROKEN)
def test_a_broken_frame_is_missing_and_named(tmp_path: Path, entry: Any, reason: str) -> None:
    poses = read_assembly101_poses(_written(tmp_path / "r.json", [_entry(1, 2), entry, _entry(3, 4)]))
    assert len(poses) == 3
    assert np.isnan(poses.landmarks_world_mm[1]).all() and np.isfinite(poses.landmarks_world_mm[[0, 2]]).all()
    (sentence,) = poses.problems
    assert "r.json, frame 1" in sentence and reason in sentence


@pytest.mark.parametrize(
    ("content", "reason"),
    [("{}", "expected a JSON list"), ("[", "no JSON"), ("[1, 2]", "none of its 2 frames"), ("\xff", "no JSON")],
)
def test_files_that_are_none(tmp_path: Path, content: str, reason: str) -> None:
    (tmp_path / "r.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(FormatError, match=f"r.json.*{reason}"):
        read_assembly101_poses(tmp_path / "r.json")


def test_no_room_is_made_for_more_frames_than_six_digits_can_name(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(f"[{'0,' * 10**6}0]")
    with pytest.raises(FormatError, match="expected a JSON list, got a list of 1000001"):
        read_assembly101_poses(tmp_path / "r.json")


def test_a_recording_without_frames(tmp_path: Path) -> None:
    assert len(read_assembly101_poses(_written(tmp_path / "r.json", []))) == 0
