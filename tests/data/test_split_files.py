"""The files of a split hold what all of its recordings bring, whenever each of them came."""

from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.assemblyhands import (
    EgoCalibration,
    JointAnnotations,
    read_ego_calibration,
    read_joint_annotations,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.fine_grained import Action, Segment, read_fine_grained, write_fine_grained_30fps
from assemblyhands_core.data.layout import DatasetLayout, read_split
from assemblyhands_core.data.split_files import ACTIONS_SHARE, EGO_SHARE, JOINTS_SHARE, write_shared_files

FIRST = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
SECOND = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"
THIRD = "nusar-2021_action_both_1002-b01a_1002_user_id_2022-03-04_140549"
VIEWS = ("C10095_rgb", "C10115_rgb")


@pytest.fixture
def layout(tmp_path: Path) -> DatasetLayout:
    return DatasetLayout(tmp_path)


def bring(layout: DatasetLayout, recording: str, value_mm: float, has_headset: bool = True) -> None:
    folder = layout.labels(recording)
    joints = JointAnnotations(np.array([0, 60]), np.full((2, 2, 21, 3), value_mm), np.ones((2, 2, 21), dtype=bool))
    write_joint_annotations(folder / JOINTS_SHARE, {recording: joints})
    if has_headset:
        K = np.array([[[130.0, 0, 318], [0, 130, 240], [0, 0, 1]]])
        pose = np.eye(4)[None, None]
        ego = EgoCalibration(("HMC_84355350_mono10bit",), K, np.array([0]), pose)
        write_ego_calibration(folder / EGO_SHARE, {recording: ego})
    action = Action.of("screw", "wheel", ("screw", "wheel"))
    segment = Segment(recording, 3, 40, 30, action, "c09a", "fire truck", views=VIEWS)
    write_fine_grained_30fps(folder / ACTIONS_SHARE, [segment])


def test_recordings_join_their_split_one_by_one(layout: DatasetLayout) -> None:
    for value, name in enumerate((SECOND, THIRD)):
        bring(layout, name, float(value))
        write_shared_files(layout, {name: "test"})
    assert read_split(layout.split("test")) == sorted([SECOND, THIRD])
    joints = read_joint_annotations(layout.annotations("test", "joint_3d"))
    assert {name: found.joints_world_mm.max() for name, found in joints.items()} == {SECOND: 0.0, THIRD: 1.0}
    assert set(read_ego_calibration(layout.annotations("test", "ego_calib"))) == {SECOND, THIRD}
    at_30, at_60 = (read_fine_grained(layout.fine_grained("test", rate)).segments for rate in (30, 60))
    assert {segment.recording for segment in at_30} == {SECOND, THIRD}
    assert [(s.start_frame, s.end_frame, s.views) for s in at_30] == [(3, 40, VIEWS)] * 2
    assert [(s.start_frame, s.end_frame, s.views) for s in at_60] == [(6, 81, ())] * 2
    assert len(layout.actions.read_text().splitlines()) == 2 and layout.skeleton.is_file()


def test_a_recording_that_moves_leaves_its_old_split(layout: DatasetLayout) -> None:
    bring(layout, FIRST, 1.0)
    write_shared_files(layout, {FIRST: "val"})
    write_shared_files(layout, {FIRST: "test"})
    assert read_split(layout.split("val")) == [] and read_split(layout.split("test")) == [FIRST]
    assert read_joint_annotations(layout.annotations("val", "joint_3d")) == {}


def test_a_rig_without_headset_brings_no_ego_calibration(layout: DatasetLayout) -> None:
    bring(layout, FIRST, 1.0, has_headset=False)
    write_shared_files(layout, {FIRST: "desktop"})
    assert not layout.annotations("desktop", "ego_calib").exists()


def test_a_person_in_two_splits_is_refused_and_nothing_changes(layout: DatasetLayout) -> None:
    for name in (SECOND, THIRD):
        bring(layout, name, 0.0)
    write_shared_files(layout, {SECOND: "test"})
    with pytest.raises(ValueError, match="participant 1002 occurs in the splits"):
        write_shared_files(layout, {THIRD: "train"})
    assert read_split(layout.split("test")) == [SECOND] and not layout.split("train").exists()
