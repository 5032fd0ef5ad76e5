"""Manual annotations by frames of the videos, whatever their rate and first key."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.assemblyhands import JointAnnotations, write_joint_annotations
from assemblyhands_core.data.camera_rows import missing_camera_row
from assemblyhands_core.data.catalog import SOURCES, VIEWS
from stages._contract import Context
from stages.read_labels import STAGE, ReadLabelsConfig

RECORDING = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
JOINTS_MM = np.random.default_rng(0).normal(200, 90, (3, 2, 21, 3))


def _read(folder: Path, keys: list[int], rate_hz: float = 30.0, first_key: int | None = 0, **changes: Any) -> list[Any]:
    is_valid = np.ones((len(keys), 2, 21), dtype=bool)
    is_valid[1, 0], is_valid[2, 1, 5] = False, False
    joints = np.where(is_valid[..., None], JOINTS_MM[: len(keys)], np.nan)
    path = folder / "joint_3d.json"
    write_joint_annotations(path, {RECORDING: JointAnnotations(np.array(keys), joints, is_valid)})
    name = changes.get("name", "joint_3d")
    source = {"sequence_id": RECORDING, "role": "labels", "name": name, "source_file": str(path), "sha256": ""}
    view = {"sequence_id": RECORDING, "camera_id": "a", "video_file": "", "video_sha256": "", "num_frames": 9}
    view |= {"rate_hz": rate_hz, "image_fit": "same", "note": "", "valid": True, "reason": "", **missing_camera_row()}
    inputs = {"sources": SOURCES.from_rows([source]), "views": VIEWS.from_rows([view])}
    recording = changes.get("sequence_id", RECORDING)
    return STAGE.run(ReadLabelsConfig(first_key=first_key), inputs, Context(folder, recording))["labels"].to_pylist()


def test_every_hand_that_anyone_annotated_has_a_row(tmp_path: Path) -> None:
    rows = _read(tmp_path, [0, 60, 120])
    assert [(r["frame"], r["hand"]) for r in rows] == [
        (0, "right"),
        (0, "left"),
        (30, "left"),
        (60, "right"),
        (60, "left"),
    ]
    np.testing.assert_allclose(np.reshape(rows[2]["joints_world_mm"], (21, 3)), JOINTS_MM[1, 1], atol=1e-4)
    assert sum(rows[4]["valid"]) == 20 and not rows[4]["valid"][5] and np.isnan(rows[4]["joints_world_mm"][15])
    assert {r["source"] for r in rows} == {"manual"}


@pytest.mark.parametrize(
    ("rate_hz", "first_key", "name", "frames"),
    [
        (60.0, 0, "joint_3d", {84, 86, 90}),
        (30.0, None, "joint_3d", {42, 43, 45}),
        (30.0, None, "joint_3d_release", {0, 1, 3}),
        (30.0, 4, "joint_3d_release", {40, 41, 43}),
    ],
)
def test_keys_become_frames(tmp_path: Path, rate_hz: float, first_key: int | None, name: str, frames: set[int]) -> None:
    assert {row["frame"] for row in _read(tmp_path, [84, 86, 90], rate_hz, first_key, name=name)} == frames


def test_keys_between_frames_and_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"key 85 is no frame of videos that begin with key 0 .* like 1 keys in all"):
        _read(tmp_path, [84, 85, 90])
    with pytest.raises(ValueError, match=r"key 84 is no frame of videos that begin with key 90"):
        _read(tmp_path, [84, 86, 90], first_key=90)
    with pytest.raises(ValueError, match=r"videos of 25\.00 Hz"):
        _read(tmp_path, [0, 2, 4], 25.0)
    with pytest.raises(ValueError, match="has no recording other"):
        _read(tmp_path, [0, 2, 4], sequence_id="other")
