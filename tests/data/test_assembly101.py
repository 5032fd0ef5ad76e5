"""Calibrations as Assembly101 has them: the file gives the rig's cameras back, traps included."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.names import ego_calibration_name, ego_serial
from assemblyhands_core.data.rigs import match_videos, read_calibration
from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.distortion import OpenCVLens, Pinhole
from assemblyhands_core.synthetic.rig import assembly_rig

NAMES = [f"nusar-2021_action_both_10{n:02d}-a01_10{n:02d}_user_id_2022-03-02_0918{n:02d}" for n in range(40)]


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    rig = assembly_rig(20220302)
    return [*rig.exo.values(), *rig.ego.values()]


def _written(folder: Path, name: str, cameras: list[Camera]) -> Path:
    path = folder / f"{name}.json"
    write_assembly101_calibration(path, cameras)
    return path


def test_the_file_gives_the_same_cameras(tmp_path: Path, cameras: list[Camera]) -> None:
    read = load_assembly101_calibration(_written(tmp_path, NAMES[0], cameras))
    points = np.random.default_rng(0).uniform(-400, 400, (500, 3))
    assert len(read) == 12
    for camera in cameras:
        again = read[ego_calibration_name(camera.camera_id) if ego_serial(camera.camera_id) else camera.camera_id]
        expected, found = camera.project(points), again.project(points)
        assert np.isfinite(expected).all(axis=1).sum() > 100
        assert (np.isnan(expected) == np.isnan(found)).all()
        assert np.nanmax(np.abs(expected - found)) < 1e-9
        assert (again.width_px, again.height_px) == (camera.width_px, camera.height_px)
        assert (again.lens == camera.lens) and (again.T_camera_from_world == camera.T_camera_from_world).all()


def test_the_matrix_maps_world_to_camera(tmp_path: Path, cameras: list[Camera]) -> None:
    records = json.loads(_written(tmp_path, NAMES[0], cameras).read_text())
    block = next(record["Camera"] for record in records if record["Camera"]["SerialNo"] == "C10118_rgb")
    M = np.array(block["ModelViewMatrix"])
    center = -M[:3, :3].T @ M[:3, 3]
    assert np.abs(center - cameras[2].center_world_mm).max() < 1e-9
    ahead = M @ [80.0, 190.0, 80.0, 1.0]
    assert 700 < ahead[2] < 1300 and np.abs(ahead[:2]).max() < 100  # the work volume lies before the camera


def test_records_look_like_the_real_ones(tmp_path: Path, cameras: list[Camera]) -> None:
    records = json.loads(_written(tmp_path, NAMES[0], cameras).read_text())
    keys = {"DistortionModel", "ImageSizeX", "ImageSizeY", "ModelViewMatrix", "SerialNo", "cx", "cy", "fx", "fy"}
    keys |= {f"k{n}" for n in range(1, 7)} | {f"p{n}" for n in range(1, 5)}
    assert all(set(record["Camera"]) == keys for record in records)
    ego = [record for record in records if record["Camera"]["DistortionModel"] == "OVFishEye62"]
    exo = [record for record in records if record["Camera"]["DistortionModel"] == "OpenCV"]
    assert (len(ego), len(exo)) == (4, 8)
    assert all(record["Camera"]["SerialNo"].endswith("_mono10bit") for record in ego)
    assert not any(record["Camera"]["SerialNo"].startswith("HMC_") for record in ego)
    assert all((record["Type"], record["ParentName"]) == ("CX3", "cx3-01") for record in ego)  # headset 211…
    assert all("ParentName" not in record and record["Type"] == "OptiTrack Color Camera" for record in exo)


def test_order_and_locations_mislead_as_in_the_real_files(tmp_path: Path, cameras: list[Camera]) -> None:
    files = [json.loads(_written(tmp_path, name, cameras).read_text()) for name in NAMES]
    orders = {tuple(record["Camera"]["SerialNo"] for record in records) for records in files}
    assert len(orders) == len(NAMES)
    right = sum(any(record["MountingLocation"] == "Egocentric" for record in records) for records in files)
    assert 1 <= right <= 6  # one real file in twenty


def test_same_file_same_bytes(tmp_path: Path, cameras: list[Camera]) -> None:
    first, second = (_written(tmp_path / folder, NAMES[0], cameras).read_bytes() for folder in "ab")
    assert first == second


def test_videos_find_their_cameras(tmp_path: Path, cameras: list[Camera]) -> None:
    read = read_calibration(_written(tmp_path, NAMES[0], cameras))
    matched = match_videos([Path(f"{camera.camera_id}.mp4") for camera in cameras], read)
    assert len(matched.video_by_camera) == 12 and not matched.problems


@pytest.mark.parametrize("lens", [Pinhole(), OpenCVLens(k1=-0.1, k4=0.01)])
def test_lenses_that_the_format_cannot_say(tmp_path: Path, cameras: list[Camera], lens: Pinhole | OpenCVLens) -> None:
    with pytest.raises(ValueError, match=r"C10095_rgb has a .* lens .*, which the format cannot say"):
        _written(tmp_path, NAMES[0], [replace(cameras[0], lens=lens)])
