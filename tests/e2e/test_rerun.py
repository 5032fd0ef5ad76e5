"""``view`` by the command line: the file is what the run's tables say, as rerun itself reads it."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import REPOSITORY, pipeline
from rerun_rows import STATIC, read_rerun_file, read_seconds
from tiny_recording import CAMERA_IDS, HEIGHT_PX, NOISE_PX, NUM_FRAMES, WIDTH_PX

from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.store import load
from assemblyhands_core.hands.joints import HANDS


@pytest.fixture(scope="module")
def written(judged: Any) -> tuple[str, Path]:
    outcome = pipeline("view", "seq=tiny", "run=judged", "view.max_side_px=160", workspace=judged.workspace)
    return outcome.assert_done().said, judged.workspace / "runs" / "judged" / "view" / "tiny.rrd"


@pytest.fixture(scope="module")
def entities(written: tuple[str, Path]) -> dict[str, dict[str, dict[int | None, Any]]]:
    return read_rerun_file(written[1])


def test_the_file_is_whole_and_the_command_says_what_is_in_it(written: tuple[str, Path]) -> None:
    said, path = written
    assert f"{NUM_FRAMES} of {NUM_FRAMES} frames; 4 cameras; rectified pictures of 160×120 px" in said
    assert "joints of round_0, truth" in said and str(path) in said
    check = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", path], capture_output=True, text=True)
    assert check.returncode == 0 and "verified without error" in check.stdout + check.stderr


def test_every_camera_method_and_curve_has_its_entity(entities: dict[str, Any]) -> None:
    methods = [f"/world/{layer}/{hand}/{part}" for layer in ("round_0", "truth") for hand in HANDS
               for part in ("joints", "bones")]  # fmt: skip
    letters = [f"/world/round_0/{hand}/side" for hand in HANDS]
    cameras = [f"/world/cameras/{name}{part}" for name in CAMERA_IDS
               for part in ("", "/picture", *(f"/keypoints/{hand}" for hand in HANDS))]  # fmt: skip
    curves = [f"/plots/{kind}/round_0/{hand}" for kind in ("error_mm", "reprojection_px") for hand in HANDS]
    assert {"/world", *methods, *letters, *cameras, *curves} == {
        name for name in entities if not name.startswith("/__")
    }


def test_joints_are_those_of_the_table_at_their_frames(judged: Any, entities: dict[str, Any]) -> None:
    joints = load(judged.workspace / "runs/judged/round_0")
    assert len(joints) == 2 * NUM_FRAMES
    for row in joints.itertuples():
        points = np.reshape(row.joints_world_mm, (21, 3))
        entity = entities[f"/world/round_0/{row.hand}/joints"]
        assert entity["Points3D:keypoint_ids"][row.frame] == np.flatnonzero(row.valid).tolist()
        np.testing.assert_array_equal(entity["Points3D:positions"][row.frame], points[row.valid])
    for number, hand in enumerate(HANDS):
        true = entities[f"/world/truth/{hand}/joints"]["Points3D:positions"]
        assert sorted(true) == list(range(NUM_FRAMES))
        np.testing.assert_allclose(true[7], judged.tiny.joints_mm[7, number], atol=1e-3)


def test_curves_are_the_mean_errors(judged: Any, entities: dict[str, Any]) -> None:
    errors = load(judged.workspace / "runs/judged/evaluation_0", "errors")
    curve = entities["/plots/error_mm/round_0/left"]["Scalars:scalars"]
    for row in errors[errors.hand == "left"].itertuples():
        assert curve[row.frame] == pytest.approx([np.nanmean(row.error_mm)], abs=1e-3)


def test_what_the_file_projects_is_where_its_keypoints_are(judged: Any, entities: dict[str, Any]) -> None:
    for name in CAMERA_IDS:
        camera = entities[f"/world/cameras/{name}"]
        K, R_world_from_camera = (
            np.reshape(camera[part][STATIC][0], (3, 3)).T
            for part in ("Pinhole:image_from_camera", "Transform3D:mat3x3")
        )
        keypoints = entities[f"/world/cameras/{name}/keypoints/right"]
        for frame in (0, NUM_FRAMES - 1):
            joint = keypoints["Points2D:keypoint_ids"][frame]
            world = judged.tiny.joints_mm[frame, 0, joint] - camera["Transform3D:translation"][STATIC][0]
            x, y, depth = K @ R_world_from_camera.T @ world.T
            off_px = np.stack([x / depth, y / depth], axis=1) - keypoints["Points2D:positions"][frame]
            assert len(joint) == 21 and np.abs(off_px).max() < 0.5 * 5 * NOISE_PX  # at half the scale
            assert np.abs(np.median(off_px, axis=0)).max() < NOISE_PX / 2


def test_every_frame_has_a_picture_in_every_view(written: tuple[str, Path], entities: dict[str, Any]) -> None:
    for name in CAMERA_IDS:
        blobs = entities[f"/world/cameras/{name}/picture"]["EncodedImage:blob"]
        assert sorted(blobs) == list(range(NUM_FRAMES))
        assert decode_image(bytes(blobs[5][0])).shape == (HEIGHT_PX // 2, WIDTH_PX // 2, 3)
    seconds = read_seconds(written[1], "/world/cameras/top/picture")
    assert seconds[0] == 0 and seconds[15] == pytest.approx(0.5)


def test_some_frames_without_pictures_are_a_small_file(judged: Any) -> None:
    choice = ("view.first_frame=4", "view.num_frames=10", "view.step=3", "view.pictures=false")
    outcome = pipeline("view", "seq=t*", "run=judged", *choice, workspace=judged.workspace).assert_done()
    assert f"4 of {NUM_FRAMES} frames" in outcome.said and "view.first_frame" in outcome.said
    found = read_rerun_file(judged.workspace / "runs/judged/view/tiny.rrd")
    assert sorted(found["/world/round_0/right/joints"]["Points3D:positions"], key=str) == [10, 13, 4, 7]
    assert "/world/cameras/front/picture" not in found


def test_mistakes_are_sentences(judged: Any) -> None:
    pipeline("view", "seq=tiny", "run=none", workspace=judged.workspace).assert_refused(
        2, "there is no run none", "judged"
    )
    pipeline("view", "seq=monday", workspace=judged.workspace).assert_refused(
        2, "no cameras of sequence monday", "tiny"
    )
    hidden = {"PYTHONPATH": f"{_without_rerun(judged.workspace.parent)}{os.pathsep}{REPOSITORY}"}
    outcome = pipeline("view", "seq=tiny", workspace=judged.workspace, environment=hidden)
    outcome.assert_refused(2, "rerun-sdk", "pip install")


def _without_rerun(folder: Path) -> Path:
    """Return a folder in which importing rerun fails, as where it is not installed."""
    blocked = folder / "blocked"
    blocked.mkdir()
    (blocked / "rerun.py").write_text("raise ImportError('not installed')\n")
    return blocked
