"""Views that are damaged, missing or strange: the run goes on with the others, and says why."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import Outcome, pipeline
from tiny_recording import NUM_FRAMES, TinyRecording, write_recording

from assemblyhands_core.data.store import load

GOOD = ("front", "right")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> TinyRecording:
    """Two good views, and one of each kind of bad one."""
    recording = write_recording(tmp_path_factory.mktemp("damaged") / "tiny")
    back = recording.video("back")
    back.write_bytes(back.read_bytes()[: int(0.7 * back.stat().st_size)])
    recording.video("top").write_bytes(b"")
    recording.video("floor").write_text("This is no video.\n" * 100)
    recording.video("door").write_bytes(recording.video("front").read_bytes())  # in no calibration
    cameras = json.loads(recording.calibration.read_text())
    for name in ("floor", "left"):  # left has no video
        cameras.append({**cameras[0], "Camera": {**cameras[0]["Camera"], "SerialNo": name}})
    recording.calibration.write_text(json.dumps(cameras))
    return recording


@pytest.fixture(scope="module")
def run(recording: TinyRecording, tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    workspace = tmp_path_factory.mktemp("damaged_run") / "work"
    return pipeline("executor=serial", *recording.overrides(), workspace=workspace), workspace


def _load(run: tuple[Outcome, Path], node: str, table: str | None = None) -> pd.DataFrame:
    return load(run[1] / "runs" / "latest" / node, table)


def test_bad_views_have_reasons_and_the_run_goes_on(run: tuple[Outcome, Path]) -> None:
    left_out = "top, floor (unreadable_video); left (missing_video); door (no_calibration)"
    assert f"tiny: views left out: {left_out}; `doctor` says more" in run[0].assert_done().said
    views = _load(run, "ingest", "views").set_index("camera_id")
    assert views.reason.to_dict() == {
        **dict.fromkeys(GOOD, ""),
        "back": "",
        "top": "unreadable_video",
        "floor": "unreadable_video",
        "left": "missing_video",
        "door": "no_calibration",
    }
    assert views.valid.tolist() == (views.reason == "").tolist()
    for name, part in {
        "back": "breaks off after",
        "top": "top.mp4",
        "floor": "floor.mp4",
        "left": "no video is named after camera left",
        "door": "rename it to <camera>.mp4",
    }.items():
        assert part in views.note[name]
    assert 0 < views.num_frames["back"] < NUM_FRAMES == views.num_frames["front"]


def test_joints_come_from_the_good_views(run: tuple[Outcome, Path], recording: TinyRecording) -> None:
    joints = _load(run, "round_0")
    found_mm = np.stack(joints.joints_world_mm.tolist()).reshape(NUM_FRAMES, 2, 21, 3)
    assert np.stack(joints.valid.tolist()).all()
    assert np.median(np.linalg.norm(found_mm - recording.joints_mm, axis=-1)) < 10.0  # 0.4 px at 2.3 m is 3.5 mm
    num_views = np.stack(joints.num_views.tolist())
    assert num_views.min() >= 2 and num_views.max() <= 3


def test_every_row_that_is_missing_is_counted_with_its_reason(run: tuple[Outcome, Path]) -> None:
    num_back = int(_load(run, "ingest", "views").set_index("camera_id").num_frames["back"])
    crops = _load(run, "crop_hands")
    reasons = crops.groupby(["camera_id", "reason"]).size().to_dict()
    rows = 2 * NUM_FRAMES  # of each camera
    assert reasons == {
        **{(name, ""): rows for name in GOOD},
        ("back", ""): 2 * num_back,
        ("back", "missing_frame"): rows - 2 * num_back,
        ("top", "unreadable_video"): rows,
        ("floor", "unreadable_video"): rows,
        ("left", "missing_video"): rows,
        ("door", "no_calibration"): rows,
    }


def test_doctor_names_them_all(recording: TinyRecording, run: tuple[Outcome, Path]) -> None:
    found = pipeline("doctor", "executor=serial", *recording.overrides(), workspace=run[1]).assert_done()
    for words in (
        "missing_video: this view is left out",
        "no_calibration: this view is left out",
        "unreadable_video: this view is left out",
        "breaks off",
    ):
        assert words in found.said


def test_with_one_good_view_the_reasons_are_in_the_error(recording: TinyRecording, tmp_path: Path) -> None:
    videos = f"rig.videos={recording.folder}/videos/[ft]*.mp4"  # front, floor, top
    workspace = tmp_path / "work"
    outcome = pipeline("executor=serial", *recording.overrides(), videos, workspace=workspace)
    outcome.assert_refused(1, "1 usable views, 3D needs 2", "top (unreadable_video:", "left (missing_video:")


@pytest.mark.slow
def test_a_recording_of_any_length_is_annotated(tmp_path: Path, undisturbed: Any) -> None:
    """One frame is fewer than chunks are asked for."""
    command = ["executor=serial", *undisturbed.recording.overrides(), "ingest.max_frames=1"]
    pipeline(*command, workspace=tmp_path / "work").assert_done()
    assert len(load(tmp_path / "work" / "runs" / "latest" / "round_0")) == 2
