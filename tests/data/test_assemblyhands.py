"""AssemblyHands annotations: conventions of the release, exact round trips, refusals."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.assemblyhands import (
    RECTIFIED_FOCAL_SCALE,
    EgoCalibration,
    JointAnnotations,
    frame_key,
    read_ego_calibration,
    read_joint_annotations,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import load_assembly101_calibration
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.synthetic.mounts import look_at
from assemblyhands_core.synthetic.rig import assembly_rig

RECORDING = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"


def _joints(num_frames: int, seed: int = 0) -> JointAnnotations:
    rng = np.random.default_rng(seed)
    is_valid = rng.random((num_frames, 2, 21)) > 0.2
    joints = np.where(is_valid[..., None], rng.normal(200, 90, (num_frames, 2, 21, 3)), np.nan)
    return JointAnnotations(2 * np.arange(num_frames) + 100, joints, is_valid)


def _heads(num_frames: int) -> list[np.ndarray]:
    centers = np.array([-190.0, 520.0, 80.0]) + 5 * np.arange(num_frames)[:, None] * [0.2, -0.5, 1.0]
    return [look_at(center, np.array([110.0, 310.0, 80.0]), np.array([0.0, 1.0, 0.0])) for center in centers]


def _ego(num_frames: int) -> EgoCalibration:
    rig = assembly_rig(20220302)
    cameras = [rig.ego_at(head) for head in _heads(num_frames)]
    K = np.array([rectified(camera, RECTIFIED_FOCAL_SCALE).K for camera in rig.ego.values()])
    poses = np.array([[camera.T_camera_from_world for camera in at.values()] for at in cameras])
    return EgoCalibration(tuple(rig.ego), K, 2 * np.arange(num_frames), poses)


def test_joints_stand_right_hand_first_under_keys_that_step_by_two(tmp_path: Path) -> None:
    joints = np.arange(2 * 42 * 3, dtype=float).reshape(2, 2, 21, 3)
    path = tmp_path / "a.json"
    write_joint_annotations(
        path, {RECORDING: JointAnnotations(np.array([84, 86]), joints, np.ones((2, 2, 21), dtype=bool))}
    )
    blocks = json.loads(path.read_text())["annotations"][RECORDING]
    assert list(blocks) == ["000084", "000086"]
    assert blocks["000084"]["world_coord"][20] == [60.0, 61.0, 62.0]  # right wrist
    assert blocks["000084"]["world_coord"][21] == [63.0, 64.0, 65.0]  # left thumb tip
    assert blocks["000086"]["joint_valid"] == [1] * 42


@given(num_frames=st.integers(0, 5), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_joints_round_trip(tmp_path_factory: pytest.TempPathFactory, num_frames: int, seed: int) -> None:
    path, joints = tmp_path_factory.mktemp("joints") / "a.json", _joints(num_frames, seed)
    write_joint_annotations(path, {RECORDING: joints, "other": _joints(1)})
    read = read_joint_annotations(path)
    assert list(read) == [RECORDING, "other"]
    assert (read[RECORDING].frames_60hz == joints.frames_60hz).all()
    assert np.array_equal(read[RECORDING].joints_world_mm, joints.joints_world_mm, equal_nan=True)
    assert (read[RECORDING].is_valid == joints.is_valid).all()


def test_frames_are_sorted_and_valid_may_be_a_column_of_flags(tmp_path: Path) -> None:
    block = {"world_coord": [[1, 2, 3]] * 42, "joint_valid": [[1.0]] * 21 + [[0]] * 21}
    path = _dump(tmp_path, {"annotations": {"r": {"000004": block, "000002": {**block, "joint_valid": [True] * 42}}}})
    read = read_joint_annotations(path)["r"]
    assert read.frames_60hz.tolist() == [2, 4]
    assert read.is_valid.sum(axis=-1).tolist() == [[21, 21], [21, 0]]
    assert np.isnan(read.joints_world_mm[1, 1]).all() and (read.joints_world_mm[1, 0] == [1, 2, 3]).all()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda d: d.pop("annotations"), "lacks 'annotations'"),
        (lambda d: d["annotations"].update({"../../etc": {}}), "a recording is '../../etc'"),
        (lambda d: d["annotations"].update(r=[]), "r: expected a JSON object, got a list of 0"),
        (lambda d: d["annotations"]["r"].update({"2": {}}), "'2' is no frame"),
        (lambda d: d["annotations"]["r"].update({"": {}}), "'' is no frame"),
        (lambda d: d["annotations"]["r"].update({"-00002": {}}), "'-00002' is no frame"),
        (lambda d: d["annotations"]["r"]["000002"].pop("world_coord"), "frame 000002: lacks 'world_coord'"),
        (lambda d: d["annotations"]["r"]["000002"]["world_coord"].pop(), "expected 42x3 numbers, got a list of 41"),
        (lambda d: d["annotations"]["r"]["000002"]["world_coord"].append([0] * 10**6), "got a list of 43"),
        (lambda d: d["annotations"]["r"]["000002"]["world_coord"][3].append(1), "expected 42x3 numbers"),
        (lambda d: d["annotations"]["r"]["000002"]["world_coord"].__setitem__(7, ["1", 2, 3]), "expected 42x3 numbers"),
        (lambda d: d["annotations"]["r"]["000002"]["world_coord"].__setitem__(7, [float("nan")] * 3), "not finite"),
        (lambda d: d["annotations"]["r"]["000002"].update(joint_valid=[1] * 21), "joint_valid: expected 42 numbers"),
    ],
)
def test_bad_joints_are_refused(tmp_path: Path, change: Callable[[Any], Any], reason: str) -> None:
    document = {"annotations": {"r": {"000002": {"world_coord": [[1, 2, 3]] * 42, "joint_valid": [1] * 42}}}}
    document = json.loads(json.dumps(document))
    change(document)
    with pytest.raises(FormatError, match=f"a.json.*{reason}"):
        read_joint_annotations(_dump(tmp_path, document))


def test_frames_without_joints_take_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of empty frames would be 100 MB of joints, and many cameras any room at all."""
    monkeypatch.setattr(np, "full", lambda *_: pytest.fail("made room"))
    path = _dump(tmp_path, {"annotations": {"r": {f"{frame:06d}": {} for frame in range(1000)}}})
    with pytest.raises(FormatError, match="1000 entries in all are wrong"):
        read_joint_annotations(path)
    K = np.eye(3).tolist()
    block = {"intrinsics": {f"HMC_{i}": K for i in range(9)}, "extrinsics": {"000002": {}}}
    with pytest.raises(FormatError, match="has 9 cameras, no headset has more than 8"):
        read_ego_calibration(_dump(tmp_path, {"calibration": {"r": block}}))
    block = {"intrinsics": {"HMC_1": K}, "extrinsics": {"000002": {}, "000004": {"HMC_1": np.eye(4)[:3].tolist()}}}
    monkeypatch.undo()
    ego = read_ego_calibration(_dump(tmp_path, {"calibration": {"r": block}}))["r"]
    assert ego.frames_60hz.tolist() == [4] and ego.poses_at(2) == {} and list(ego.poses_at(4)) == ["HMC_1"]


def test_invalid_joints_may_be_anything(tmp_path: Path) -> None:
    block = {"world_coord": [[float("nan")] * 3] + [[1, 2, 3]] * 41, "joint_valid": [0] + [1] * 41}
    read = read_joint_annotations(_dump(tmp_path, {"annotations": {"r": {"000002": block}}}))["r"]
    assert not read.is_valid[0, 0, 0] and np.isnan(read.joints_world_mm).sum() == 3


def test_annotations_check_themselves() -> None:
    joints, is_valid = np.zeros((2, 2, 21, 3)), np.ones((2, 2, 21), dtype=bool)
    with pytest.raises(ValueError, match="do not ascend"):
        JointAnnotations(np.array([4, 4]), joints, is_valid)
    joints[1, 1, 20] = np.nan
    with pytest.raises(ValueError, match="frame 6: joint 20 of the left hand is called valid"):
        JointAnnotations(np.array([4, 6]), joints, is_valid)


def test_keys_have_six_digits() -> None:
    assert frame_key(169) == "000169"
    for frame in (-1, 10**6):
        with pytest.raises(ValueError, match="six digits"):
            frame_key(frame)


def test_headset_cameras_round_trip_and_a_frame_may_lack_one(tmp_path: Path) -> None:
    ego, path = _ego(3), tmp_path / "a.json"
    ego.T_camera_from_world[1, 2] = np.nan
    write_ego_calibration(path, {RECORDING: ego})
    read = read_ego_calibration(path)[RECORDING]
    assert (read.camera_ids, read.frames_60hz.tolist()) == (ego.camera_ids, [0, 2, 4])
    assert (read.K_px == ego.K_px).all()
    assert np.array_equal(read.T_camera_from_world, ego.T_camera_from_world, equal_nan=True)
    assert [len(read.poses_at(frame)) for frame in (0, 1, 2, 4, 6)] == [4, 0, 3, 4, 0]
    assert ego.camera_ids[2] not in read.rectified_at(2)


def test_the_file_holds_world_to_camera_under_hmc_names(tmp_path: Path) -> None:
    path, head = tmp_path / "a.json", _heads(1)[0]
    write_ego_calibration(path, {RECORDING: _ego(1)})
    block = json.loads(path.read_text())["calibration"][RECORDING]
    name = "HMC_21110305_mono10bit"
    assert sorted(block) == ["extrinsics", "intrinsics"] and list(block["extrinsics"]) == ["000000"]
    Rt = np.array(block["extrinsics"]["000000"][name])
    assert Rt.shape == (3, 4)
    camera = assembly_rig(20220302).ego[name]
    center_world = transforms.apply(transforms.inverse(head), camera.center_world_mm)
    assert np.abs(-Rt[:, :3].T @ Rt[:, 3] - center_world).max() < 1e-9
    K = np.array(block["intrinsics"][name])
    assert (
        np.abs(K - [[0.7 * camera.fx_px, 0, camera.cx_px], [0, 0.7 * camera.fy_px, camera.cy_px], [0, 0, 1]]).max() == 0
    )


def test_rectified_cameras_are_the_simulators(tmp_path: Path) -> None:
    path, points = tmp_path / "a.json", np.random.default_rng(0).uniform(0, 300, (200, 3))
    write_ego_calibration(path, {RECORDING: _ego(2)})
    read = read_ego_calibration(path)[RECORDING].rectified_at(2)
    for name, camera in assembly_rig(20220302).ego_at(_heads(2)[1]).items():
        expected, found = rectified(camera, 0.7).project(points), read[name].project(points)
        assert np.array_equal(np.isnan(expected), np.isnan(found))
        assert np.nanmax(np.abs(expected - found), initial=0) < 1e-9
        assert (read[name].width_px, read[name].height_px) == (636, 480)


def test_both_files_together_give_the_simulators_fisheyes(tmp_path: Path) -> None:
    rig, points = assembly_rig(20220302), np.random.default_rng(0).uniform(0, 300, (200, 3))
    write_ego_calibration(tmp_path / "a.json", {RECORDING: _ego(2)})
    write_assembly101_calibration(tmp_path / "c.json", [*rig.exo.values(), *rig.ego.values()])
    calibration = load_assembly101_calibration(tmp_path / "c.json")
    read = read_ego_calibration(tmp_path / "a.json")[RECORDING]
    expected = rig.ego_at(_heads(2)[1])
    assert list(read.raw_at(2, calibration)) == list(expected)
    for name, camera in read.raw_at(2, calibration).items():
        assert camera.camera_id == name
        assert np.isfinite(expected[name].project(points)).all()
        assert np.abs(camera.project(points) - expected[name].project(points)).max() < 1e-9
    with pytest.raises(ValueError, match="has no camera 21110305_mono10bit"):
        read.raw_at(2, {name: camera for name, camera in calibration.items() if name != "21110305_mono10bit"})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda b: b.pop("extrinsics"), "lacks 'extrinsics'"),
        (lambda b: b["intrinsics"].update({"a/b": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}), "a camera is 'a/b'"),
        (lambda b: b["intrinsics"].update(e1=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), "intrinsics of e1: .* is no matrix"),
        (lambda b: b["extrinsics"]["000000"].update(e2=[]), "camera 'e2' has no intrinsics"),
        (lambda b: b["extrinsics"]["000000"].update(e1=np.eye(4).tolist()), "expected 3x4 numbers, got a list of 4"),
        (lambda b: b["extrinsics"]["000000"].update(e1=(2 * np.eye(4))[:3].tolist()), "not orthonormal"),
        (lambda b: b["extrinsics"]["000000"].update(e1=np.diag([1.0, 1, -1, 1])[:3].tolist()), "mirror image"),
        (lambda b: b["extrinsics"]["000000"].update(e1=[[float("inf")] * 4] * 3), "holds NaN or infinity"),
    ],
)
def test_bad_headset_cameras_are_refused(tmp_path: Path, change: Callable[[Any], Any], reason: str) -> None:
    block = {"intrinsics": {"e1": np.eye(3).tolist()}, "extrinsics": {"000000": {"e1": np.eye(4)[:3].tolist()}}}
    change(block)
    with pytest.raises(FormatError, match=f"a.json.*{reason}"):
        read_ego_calibration(_dump(tmp_path, {"calibration": {"r": block}}))


def _dump(folder: Path, document: object) -> Path:
    path = folder / "a.json"
    path.write_text(json.dumps(document))
    return path
