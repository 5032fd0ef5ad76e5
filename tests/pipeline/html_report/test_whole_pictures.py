"""Whole pictures at an instant: of which cameras, and that the joints are drawn where they are."""

import base64
from pathlib import Path

import headset
import numpy as np
from finished_run import write_table
from html_runs import HOSTILE, finished, run_config, write_run

from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.synthetic.rig import assembly_rig
from pipeline.finished import FinishedRun
from pipeline.html_report.page import Picture
from pipeline.html_report.whole_pictures import whole_pictures


def _image(picture: Picture | None) -> np.ndarray:
    assert picture is not None
    return decode_image(base64.b64decode(picture.uri.split(",")[1]))


def _colored(image: np.ndarray) -> np.ndarray:
    """Return where (column, row) a picture is not grey."""
    return np.argwhere(np.ptp(image.astype(int), axis=-1) > 80)[:, ::-1]


def test_joints_are_drawn_where_the_headset_sees_them(tmp_path: Path) -> None:
    rig = assembly_rig(20220302)
    name = next(iter(rig.ego))
    joints = headset.hands_before(rig.ego_at(headset.heads()[0])[name])
    headset.write_run(tmp_path / "run", rig, joints)
    file = f"{headset.RECORDING}.00000.parquet"
    write_table(tmp_path / "run" / "round_0" / "joints" / file, JOINTS, headset.annotation(joints))
    run = FinishedRun(tmp_path / "run", run_config(tmp_path), {})
    picture = whole_pictures(run, (headset.RECORDING, 1, "right"), "no such camera")
    image = _image(picture)
    camera = rectified(rig.ego_at(headset.heads()[1])[name], headset.UNDISTORTED.focal_scale_fisheye)
    scale = image.shape[1] / camera.width_px
    pixels = (camera.project(joints).reshape(-1, 2) + 0.5) * scale - 0.5
    pixels[:, 1] += image.shape[0] - scale * camera.height_px  # the caption
    found = _colored(image)
    assert np.abs(found.min(axis=0) - pixels.min(axis=0)).max() < 8
    assert np.abs(found.max(axis=0) - pixels.max(axis=0)).max() < 8
    assert picture is not None and picture.alt.startswith(f"{name}, frame 1, {headset.RECORDING}")
    assert whole_pictures(run, (headset.RECORDING, 2, "right"), "") is None, "nobody knows where the headset was"


def test_the_fixed_camera_is_shown_as_long_as_its_video_is_there(tmp_path: Path) -> None:
    write_run(tmp_path, "made_up")
    run, key = finished(tmp_path, "made_up"), (HOSTILE, 3, "right")
    middle = _colored(_image(whole_pictures(run, key, "front"))).mean(axis=0)
    # 6 mm to the right of the picture's middle, 1 px a mm, below a caption of 43 px
    assert np.abs(middle - (325.5, 239.5 + 43)).max() < 6
    (tmp_path / "front.mp4").unlink()
    assert whole_pictures(run, key, "front") is None
