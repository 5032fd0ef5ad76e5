from pathlib import Path

import numpy as np
import pytest
from rerun_rows import STATIC, read_rerun_file, read_seconds

from assemblyhands_core.data.crop_images import decode_image, encode_jpeg
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.geometry.transforms import rigid
from assemblyhands_core.hands.joints import BONES, ROOT, WRIST
from assemblyhands_core.viz.first_look import look_at_hands
from assemblyhands_core.viz.rerun_file import Visibility, open_rerun_file

FRAMES = np.array([4, 6, 8])
# Camera x is the world's y, camera y (down) the world's -z, camera z the world's -x: it looks along -x, z is up.
ROTATION = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
CAMERA = Camera("front", 640, 480, 500.0, 510.0, 320.0, 240.0, Pinhole(), rigid(ROTATION, np.array([0, 0, 900.0])))
HAND = np.stack([np.arange(21.0), 10 * np.arange(21.0), np.full(21, 5.0)], axis=1)
PATH = ("world", "cameras", "front")


def _joints() -> np.ndarray:
    """Three frames: a whole hand, one without its middle finger's base, none."""
    joints = np.stack([HAND, HAND + 1, HAND + 2])
    joints[1, ROOT] = np.nan
    joints[2] = np.nan
    return joints


def test_joints_and_bones_of_every_frame_and_none_where_there_are_none(tmp_path: Path) -> None:
    with open_rerun_file(tmp_path / "a.rrd", "a", 2.0) as file:
        file.joints(["world", "round_3", "left"], FRAMES, _joints(), "left", (1, 2, 3))
    found = read_rerun_file(tmp_path / "a.rrd")
    joints, bones = (found[f"/world/round_3/left/{part}"] for part in ("joints", "bones"))
    positions = joints["Points3D:positions"]
    np.testing.assert_allclose(positions[4], HAND)
    assert joints["Points3D:keypoint_ids"][6] == [joint for joint in range(21) if joint != ROOT]
    np.testing.assert_allclose(positions[6], np.delete(HAND + 1, ROOT, axis=0))
    assert positions[8] == [] and bones["LineStrips3D:strips"][8] == []
    assert set(joints["Points3D:class_ids"][4]) == {1}
    np.testing.assert_allclose(bones["LineStrips3D:strips"][4], HAND[np.array(BONES)])
    assert len(bones["LineStrips3D:strips"][6]) == len(BONES) - 2  # one on either side of the missing joint


def test_a_letter_beyond_the_wrist_says_which_hand_it_is(tmp_path: Path) -> None:
    with open_rerun_file(tmp_path / "a.rrd", "a", 2.0) as file:
        file.side(["world", "round_3", "left"], FRAMES, _joints(), "left", (1, 2, 3))
    side = read_rerun_file(tmp_path / "a.rrd")["/world/round_3/left/side"]
    assert side["Points3D:labels"][STATIC] == ["L"]
    np.testing.assert_allclose(side["Points3D:positions"][4], [2 * HAND[WRIST] - HAND[ROOT]])
    assert side["Points3D:positions"][6] == [] == side["Points3D:positions"][8]


def test_frames_have_seconds_where_the_rate_is_known(tmp_path: Path) -> None:
    for rate_hz, name in ((2.0, "known"), (float("nan"), "unknown")):
        with open_rerun_file(tmp_path / f"{name}.rrd", name, rate_hz) as file:
            file.plot(["error_mm", "round_3"], FRAMES, np.array([1.0, np.nan, 3.0]), "left", (1, 2, 3))
    assert read_seconds(tmp_path / "known.rrd", "/plots/error_mm/round_3/left") == {4: 2.0, 8: 4.0}
    unknown = read_rerun_file(tmp_path / "unknown.rrd")["/plots/error_mm/round_3/left"]
    assert unknown["Scalars:scalars"] == {4: [1.0], 8: [3.0]}


def test_a_camera_is_where_it_is_and_projects_as_ours_does(tmp_path: Path) -> None:
    with open_rerun_file(tmp_path / "a.rrd", "a", 30.0) as file:
        file.camera(PATH, CAMERA, 150.0)
        file.place(PATH, CAMERA.T_camera_from_world)
    (matrix,) = read_rerun_file(tmp_path / "a.rrd")["/world/cameras/front"]["Pinhole:image_from_camera"][STATIC]
    camera = read_rerun_file(tmp_path / "a.rrd")["/world/cameras/front"]
    (translation,) = camera["Transform3D:translation"][STATIC]
    (rotation,) = camera["Transform3D:mat3x3"][STATIC]
    np.testing.assert_allclose(translation, [900.0, 0, 0])  # where it looks along -x from
    np.testing.assert_allclose(translation, CAMERA.center_world_mm)
    K, R_world_from_camera = (np.reshape(values, (3, 3)).T for values in (matrix, rotation))  # by columns
    point = np.array([100.0, 50.0, 20.0])
    x, y, depth = K @ R_world_from_camera.T @ (point - translation)
    np.testing.assert_allclose([x / depth, y / depth], CAMERA.project(point) + 0.5, rtol=1e-6)
    assert camera["Pinhole:resolution"][STATIC] == [[640.0, 480.0]]


def test_a_moving_camera_is_where_it_is_at_each_frame(tmp_path: Path) -> None:
    poses = np.stack([rigid(ROTATION, np.array([0, 0, z])) for z in (900.0, 800.0, 700.0)])
    with open_rerun_file(tmp_path / "a.rrd", "a", 30.0) as file:
        file.places(PATH, FRAMES, poses)
    camera = read_rerun_file(tmp_path / "a.rrd")["/world/cameras/front"]
    assert camera["Transform3D:translation"] == {4: [[900.0, 0, 0]], 6: [[800.0, 0, 0]], 8: [[700.0, 0, 0]]}
    for frame in FRAMES.tolist():
        np.testing.assert_allclose(
            np.reshape(camera["Transform3D:mat3x3"][frame], (3, 3)), ROTATION
        )  # columns of the inverse


def test_keypoints_are_half_a_pixel_on_and_missing_ones_left_out(tmp_path: Path) -> None:
    pixels = _joints()[..., :2]
    with open_rerun_file(tmp_path / "a.rrd", "a", 30.0) as file:
        file.keypoints([*PATH, "keypoints", "right"], FRAMES, pixels, "right")
    found = read_rerun_file(tmp_path / "a.rrd")["/world/cameras/front/keypoints/right"]
    np.testing.assert_allclose(found["Points2D:positions"][4], HAND[:, :2] + 0.5)
    assert len(found["Points2D:positions"][6]) == 20 and found["Points2D:positions"][8] == []


def test_pictures_are_the_bytes_that_were_given_and_can_end(tmp_path: Path) -> None:
    picture = np.full((6, 8, 3), (200, 100, 50), np.uint8)
    with open_rerun_file(tmp_path / "a.rrd", "a", 30.0) as file:
        file.picture([*PATH, "picture"], 4, encode_jpeg(picture, 95))
        file.picture([*PATH, "picture"], 6, None)
    found = read_rerun_file(tmp_path / "a.rrd")["/world/cameras/front/picture"]
    (blob,) = found["EncodedImage:blob"][4]
    assert np.abs(decode_image(bytes(blob)).astype(int) - picture).max() < 8
    assert found["EncodedImage:media_type"][4] == ["image/jpeg"] and found["Clear:is_recursive"] == {6: [False]}


def test_the_layout_is_part_of_the_file(tmp_path: Path) -> None:
    with open_rerun_file(tmp_path / "a.rrd", "a", 30.0) as file:
        file.world("+z")
        file.camera(PATH, CAMERA, 150.0)
        file.layout(
            [PATH],
            {"round_0": Visibility(False, True), "truth": Visibility(True, False)},
            look_at_hands(HAND, [CAMERA], "+z"),
        )
    found = read_rerun_file(tmp_path / "a.rrd")["/world"]
    assert found["ViewCoordinates:xyz"][STATIC] == [[3, 5, 1]]  # right, forward, up
    assert len(found["AnnotationContext:context"][STATIC][0]) == 2


def test_what_fails_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    path.write_bytes(b"before")
    with pytest.raises(ZeroDivisionError), open_rerun_file(path, "a", 30.0) as file:
        file.camera(PATH, CAMERA, 150.0)
        raise ZeroDivisionError
    assert path.read_bytes() == b"before" and list(tmp_path.iterdir()) == [path]
