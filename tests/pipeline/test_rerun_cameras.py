"""The headset in a file for rerun: where its cameras are, and that its pictures show what is there."""

from pathlib import Path

import headset
import numpy as np
import pytest
from rerun_rows import read_rerun_file

from assemblyhands_core.data.crop_images import decode_image, encode_jpeg
from assemblyhands_core.data.ego_views import EgoView
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.hands.joints import WRIST
from assemblyhands_core.synthetic.rig import Rig, assembly_rig
from assemblyhands_core.viz.rectified_pictures import PictureRectifier
from pipeline.config import ViewConfig
from pipeline.rerun_cameras import HeadsetCamera
from pipeline.rerun_scene import write_scene
from pipeline.sequence_tables import SequenceTables


@pytest.fixture(scope="module")
def rig() -> Rig:
    return assembly_rig(20220302)


def test_the_headset_moves_and_its_pictures_show_what_the_camera_projects(tmp_path: Path, rig: Rig) -> None:
    joints = headset.hands_before(next(iter(rig.ego_at(headset.heads()[0]).values())))
    headset.write_run(tmp_path / "run", rig, joints)
    tables = SequenceTables(tmp_path / "run", headset.RECORDING)
    said = write_scene(tmp_path / "a.rrd", tables, ViewConfig(max_side_px=318), 0.1, truth=None)
    assert "4 of 4 frames; 1 cameras; rectified pictures of 318×240 px; joints of ingest_ego" in said
    name, found = next(iter(rig.ego)), read_rerun_file(tmp_path / "a.rrd")
    camera, pictures = found[f"/world/headset/{name}"], found[f"/world/headset/{name}/picture"]
    assert sorted(camera["Transform3D:translation"]) == [0, 1, 3] == sorted(pictures["EncodedImage:blob"])
    assert list(pictures["Clear:is_recursive"]) == [2]  # of which nobody knows where the camera was
    (K,) = camera["Pinhole:image_from_camera"][None]
    for frame in (0, 1, 3):
        true = rig.ego_at(headset.heads()[frame])[name]
        center, rotation = camera["Transform3D:translation"][frame][0], camera["Transform3D:mat3x3"][frame][0]
        np.testing.assert_allclose(center, true.center_world_mm, atol=1e-3)
        picture = decode_image(bytes(pictures["EncodedImage:blob"][frame][0]))
        for wrist in joints[:, WRIST]:
            x, y, depth = np.reshape(K, (3, 3)).T @ np.reshape(rotation, (3, 3)) @ (wrist - center)
            column, row = x / depth - 0.5, y / depth - 0.5  # rerun counts from the corner of pixel 0
            left, top = round(column) - 6, round(row) - 6
            around = picture[top : top + 13, left : left + 13, 0]
            peak = np.unravel_index(np.argmax(around), around.shape)
            assert around.max() > 80 and np.hypot(left + peak[1] - column, top + peak[0] - row) < 1


def test_a_release_s_pictures_are_shown_where_there_are_pose_and_picture(tmp_path: Path, rig: Rig) -> None:
    camera = rectified(next(iter(rig.ego.values())), 0.7)
    joints = headset.hands_before(camera)
    files = {frame: str(tmp_path / f"{frame}.jpg") for frame in (0, 1, 2)}
    for frame in (0, 1):
        Path(files[frame]).write_bytes(encode_jpeg(headset.spots(camera, joints), 95))
    poses = dict.fromkeys((0, 2, 3), camera.T_camera_from_world)
    grid = RemapGrid.build(camera, camera)
    view = EgoView(camera.camera_id, "", files, camera, grid, poses, {}, {})
    shown = HeadsetCamera(view, PictureRectifier(camera, grid, 1000))
    found = dict(shown.pictures(np.arange(5)))
    assert list(found) == [0]  # 1 has no pose, 2 no file, 3 no picture, 4 neither
    np.testing.assert_allclose(shown.rectifier(found[0]), found[0], atol=2)  # it is rectified already
