"""Which poses a segment gets, and what becomes of labels that are odd; hands are where the time says."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from assemblyhands_core.data.assemblyhands import JointAnnotations, write_joint_annotations
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.fine_grained import (
    Action,
    Segment,
    write_fine_grained_30fps,
    write_fine_grained_60fps,
)
from assemblyhands_core.data.label_rows import FROM_FIRST_KEY
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from stages._contract import Context, Tables
from stages.cut_verb_clips import STAGE, CutVerbClipsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "cut_verb_clips.yaml"
NAME = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
OTHER = NAME.replace("1001", "1002")
HAND = np.random.default_rng(0).normal(0, 40, (2, NUM_JOINTS, 3))
STEP_MM = 12.0  # along x in a frame
CAMERA = Camera("C1_rgb", 64, 48, 50.0, 50.0, 31.5, 23.5, Pinhole(), np.eye(4))


def _segment(start: int, end: int, verb: str = "screw", recording: str = NAME, rate_hz: Any = 60) -> Segment:
    action = Action.of(verb, "bolt", ("wheel", "bolt"))
    return Segment(recording, start, end, rate_hz, action, views=("C1_rgb", "C2_rgb"))


def _joints(frames: list[int], **changes: Any) -> pa.Table:
    rows = [
        {
            "sequence_id": NAME,
            "frame": frame,
            "hand": hand,
            "joints_world_mm": np.add(points, [STEP_MM * frame, 0, 0]).ravel(),
            "valid": np.ones(NUM_JOINTS, dtype=bool),
            "reason": [""] * NUM_JOINTS,
            "num_views": np.full(NUM_JOINTS, 2),
            "reprojection_px": np.zeros(NUM_JOINTS),
            "source": "mvexonet",
            "round": 3,
            **changes,
        }
        for frame in frames
        for hand, points in zip(HANDS, HAND, strict=True)
    ]
    return JOINTS.from_rows(rows)


def _views(num_frames: int, rate_hz: float, is_valid: bool = True) -> pa.Table:
    """One camera that can be used, unless told otherwise, and one that cannot."""
    rows = []
    for name, valid, count in (("C1_rgb", is_valid, num_frames), ("C2_rgb", False, 999)):
        row = {"sequence_id": NAME, "camera_id": name, "video_file": "", "video_sha256": "", "num_frames": count}
        row |= {"rate_hz": rate_hz if valid else np.nan, "image_fit": "same", "note": ""}
        row |= camera_to_row(CAMERA) if valid else missing_camera_row()
        rows.append(row | {"valid": valid, "reason": "" if valid else "unreadable_video"})
    return VIEWS.from_rows(rows)


def _source(role: str, name: str, path: Path) -> dict[str, str]:
    return {"sequence_id": NAME, "role": role, "name": name, "source_file": str(path), "sha256": ""}


def _run(
    csv: Path, joints: pa.Table, views: pa.Table, labels: tuple[dict[str, str], ...] = (), **changes: Any
) -> Tables:
    config = CutVerbClipsConfig.model_validate({**yaml.safe_load(CONF.read_text()), **changes}, strict=False)
    actions = SOURCES.from_rows([_source("actions", "fine_grained", csv), *labels])
    return STAGE.run(config, {"actions": actions, "views": views, "joints": joints}, Context(Path(), NAME))


def _x_frames(clip: PoseClip) -> np.ndarray:
    """Return of every instant and hand at which frame it is, by the hand's place."""
    return (clip.nodes_mm[:, :, 0, 0] - HAND[:, 0, 0].astype(np.float32)) / STEP_MM


@pytest.mark.parametrize("form", ["30fps", "60fps"])
def test_two_frames_at_10_hz_become_four_instants_at_30(tmp_path: Path, form: str) -> None:
    csv, write = tmp_path / "train.csv", {"30fps": write_fine_grained_30fps, "60fps": write_fine_grained_60fps}[form]
    write(csv, [_segment(6, 7)])  # the second frame of 10 Hz is at keys 6 to 11
    made = _run(csv, _joints([1, 2]), _views(10, 10.0), context_keys=6)
    ((segment, clip),) = clips_of(made["clips"])
    assert segment == VerbSegment(NAME, 0, "screw", "bolt", 6, 7) and clip.graph == "skeleton"
    assert set(made["clips"]["rate_hz"].to_pylist()) == {30}
    # Context goes from key 0 to 13, instants lie at keys 0, 2 … 12; poses are known at keys 6 and 12.
    expected = np.array([1, 1, 1, 1, 4 / 3, 5 / 3, 2])
    np.testing.assert_allclose(_x_frames(clip), np.stack([expected, expected], axis=1), atol=1e-5)
    np.testing.assert_array_equal(clip.observed[:, 0], [False, False, False, True, False, False, True])
    np.testing.assert_array_equal(clip.is_interpolated, ~clip.observed)
    assert made["problems"].num_rows == 0


def test_odd_labels_are_counted_and_named_and_the_others_cut(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    good = [
        _segment(0, 59),
        _segment(20, 29, "position"),  # inside the first one
        _segment(20, 29, "position"),
        _segment(90, 140, "remove"),  # the last third is beyond the video
        _segment(120, 200),  # all of it is
        _segment(0, 9, "clap"),
        _segment(0, 9, recording=OTHER),
    ]
    write_fine_grained_60fps(csv, good)
    lines = csv.read_text().splitlines()
    lines.append(lines[1].replace("000000059", "x"))
    lines.append(lines[1].replace("000000000,", "000000070,"))  # ends before it begins
    lines.append(lines[1].replace(",screw,", ",dance,"))
    csv.write_text("\n".join(lines) + "\n")
    made = _run(csv, _joints(list(range(60))), _views(60, 30.0))
    clips = [(one.number, one.verb, one.first_key, one.last_key) for one, _ in clips_of(made["clips"])]
    assert clips == [
        (0, "screw", 0, 59),
        (1, "position", 20, 29),
        (2, "position", 20, 29),
        (3, "remove", 90, 119),
    ]
    problems = made["problems"].to_pylist()
    assert {row["reason"]: row["count"] for row in problems if not row["sentence"]} == {
        "unreadable": 3, "beyond_video": 1, "other_verb": 1, "other_recording": 1, "overlapped": 2, "cut_to_video": 1,
    }  # fmt: skip
    sentences = {row["sentence"]: row["count"] for row in problems if row["sentence"]}
    parts = {
        "line 9: its end_frame is 'x' instead of a whole number": 1,
        "line 10: it ends at frame 59 before it begins at 70": 1,
        "line 11: its verb 'dance' does not have the number 6": 1,
        "'position' at 60 Hz frames 20 to 29 is covered by another one to 100%; it is kept": 2,
        "'remove' at 60 Hz frames 90 to 119 is what lies in the recording's frames 0 to 119": 1,
        "'screw' at 60 Hz frames 120 to 200 lies outside the recording's frames 0 to 119": 1,
    }
    assert len(sentences) == len(parts)
    for part, count in parts.items():
        assert [n for sentence, n in sentences.items() if part in sentence] == [count], part
    assert {row["reason"] for row in problems if row["sentence"]} == {""}


def test_a_segment_without_poses_keeps_its_row_and_is_counted(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(0, 19), _segment(40, 79, "remove")])
    made = _run(csv, _joints(list(range(20, 60))), _views(60, 30.0), context_keys=0)
    (_, unseen), (_, seen) = clips_of(made["clips"])
    assert len(unseen) == 10 and not unseen.observed.any() and not unseen.is_interpolated.any()
    assert np.isnan(unseen.nodes_mm).all()
    assert seen.observed.all()
    np.testing.assert_allclose(_x_frames(seen)[:, 1], np.arange(20, 40), atol=1e-5)
    assert [(row["reason"], row["count"]) for row in made["problems"].to_pylist()] == [("no_poses", 1)]
    nothing = _run(csv, JOINTS.empty(), _views(60, 30.0))
    assert [len(clip) for _, clip in clips_of(nothing["clips"])] == [23, 45]  # keys 0 to 44 and 16 to 104
    assert [(row["reason"], row["count"]) for row in nothing["problems"].to_pylist()] == [("no_poses", 2)]


def test_recordings_of_few_frames_a_second_show_no_motion(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(0, 19), _segment(40, 79, "remove")])
    sparse = _run(csv, _joints([0, 1, 2]), _views(3, 2.0), min_rate_hz=4.0)
    assert sparse["clips"].num_rows == 0
    assert [(row["reason"], row["count"]) for row in sparse["problems"].to_pylist()] == [("too_few_frames", 2)]
    assert len(clips_of(_run(csv, _joints([0, 1, 2]), _views(3, 2.0), min_rate_hz=2.0)["clips"])) == 2


def test_sources_give_clips_of_the_same_instants(tmp_path: Path) -> None:
    """SVEgoNet's poses may begin later than the annotation's; their clips have to be compared all the same."""
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(4, 40)])
    annotated, predicted = (
        clips_of(_run(csv, _joints(list(frames), source=source), _views(30, 30.0))["clips"])[0][1]
        for frames, source in ((range(30), "mvexonet"), (range(5, 25), "svegonet"))
    )
    is_common = predicted.observed[:, 0]
    assert len(annotated) == len(predicted) == 30 and is_common.sum() == 20
    np.testing.assert_array_equal(annotated.nodes_mm[is_common], predicted.nodes_mm[is_common])


def test_several_rounds_in_one_table_are_refused(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(0, 19)])
    rounds = pa.concat_tables([_joints([0, 1]), _joints([0, 1], round=2)])
    with pytest.raises(ValueError, match=r"joints of rounds \[2, 3\] stand beside each other"):
        _run(csv, rounds, _views(60, 30.0))


@pytest.mark.parametrize(
    ("name", "first_key", "expected"), [(FROM_FIRST_KEY, None, 84), ("joint_3d", None, 0), (FROM_FIRST_KEY, 20, 20)]
)
def test_the_releases_pictures_begin_with_their_first_label(
    tmp_path: Path, name: str, first_key: int | None, expected: int
) -> None:
    csv, labels = tmp_path / "train.csv", tmp_path / "joint_3d.json"
    write_fine_grained_60fps(csv, [_segment(expected + 20, expected + 39)])
    known = JointAnnotations(np.array([84, 86]), np.zeros((2, 2, NUM_JOINTS, 3)), np.ones((2, 2, NUM_JOINTS), bool))
    write_joint_annotations(labels, {NAME: known})
    sources = (_source("labels", name, labels),)
    made = _run(csv, _joints(list(range(60))), _views(60, 30.0), sources, first_key=first_key, context_keys=0)
    ((_, clip),) = clips_of(made["clips"])
    np.testing.assert_allclose(_x_frames(clip)[:, 0], np.arange(10, 20), atol=1e-5)


def test_graph_and_selection_are_as_told(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(0, 29), _segment(2, 9, "remove"), _segment(40, 41, "remove")])
    options = {"verbs": ["remove"], "min_duration_s": 0.1, "is_overlap_dropped": True, "graph": "landmarks"}
    made = _run(csv, _joints(list(range(30))), _views(30, 30.0), **options)
    assert made["clips"].num_rows == 0
    assert {r["reason"]: r["count"] for r in made["problems"].to_pylist() if r["reason"]} == {
        "other_verb": 1, "overlap": 1, "too_short": 1,
    }  # fmt: skip
    kept = _run(csv, _joints(list(range(30))), _views(30, 30.0), graph="landmarks", context_keys=0)["clips"]
    assert set(kept["graph"].to_pylist()) == {"landmarks"}
    np.testing.assert_allclose(clips_of(kept)[0][1].nodes_mm[0, 0, 5], HAND[0, 20], atol=1e-4)  # the wrist


def test_without_a_usable_view_it_says_so(tmp_path: Path) -> None:
    csv = tmp_path / "train.csv"
    write_fine_grained_60fps(csv, [_segment(0, 19)])
    with pytest.raises(ValueError, match=f"sequence {NAME}: no view can be used; table views says why"):
        _run(csv, _joints([0]), _views(60, 30.0, is_valid=False))
