"""`calib.txt` and `skeleton.txt`: as the toolkit's parsers expect them, and back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.assemblyhands_rig import (
    read_exo_calibration,
    read_skeleton,
    write_exo_calibration,
    write_skeleton,
)
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.synthetic.rig import assembly_rig


def test_rectified_cameras_round_trip(tmp_path: Path) -> None:
    cameras = {name: rectified(camera, 0.97) for name, camera in assembly_rig(1).exo.items()}
    write_exo_calibration(tmp_path / "calib.txt", cameras.values())
    read = read_exo_calibration(tmp_path / "calib.txt")
    assert list(read) == list(cameras)
    for name, camera in cameras.items():
        assert (read[name].P_pixel_from_world == camera.P_pixel_from_world).all()
        assert (read[name].width_px, read[name].height_px) == (1920, 1080)


def test_eight_lines_for_each_camera(tmp_path: Path) -> None:
    camera = rectified(assembly_rig(1).exo["C10118_rgb"])
    write_exo_calibration(tmp_path / "calib.txt", [camera, rectified(assembly_rig(1).exo["C10119_rgb"])])
    lines = [line for line in (tmp_path / "calib.txt").read_text().splitlines() if line]
    assert len(lines) == 16 and (lines[0], lines[8]) == ("C10118_rgb", "C10119_rgb")
    assert [float(value) for value in lines[1].split()] == [camera.fx_px, 0.0, camera.cx_px]
    assert [float(value) for value in lines[7].split()] == camera.T_camera_from_world[2].tolist()


def test_only_rectified_cameras_are_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="C10118_rgb has a OpenCV lens: write its rectified camera"):
        write_exo_calibration(tmp_path / "calib.txt", [assembly_rig(1).exo["C10118_rgb"]])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda lines: [], "has 0 lines"),
        (lambda lines: lines[:7], "has 7 lines, not 8 for each camera"),
        (lambda lines: lines + lines, "C10118_rgb occurs twice"),
        (lambda lines: ["../x", *lines[1:]], "a camera is '../x'"),
        (lambda lines: [lines[0], "1 0", *lines[2:]], "not 3 rows of 3 finite numbers"),
        (lambda lines: [lines[0], "nan 0 1", *lines[2:]], "not 3 rows of 3 finite numbers"),
        (lambda lines: [*lines[:7], "0 0 one 0"], "not 3 rows of 4 finite numbers"),
        (lambda lines: [*lines[:7], "0 0 9 0"], "its pose is refused because its rotation is not orthonormal"),
        (lambda lines: [lines[0], "-1 0 0", *lines[2:]], "is no matrix"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, change: Callable[[list[str]], list[str]], reason: str) -> None:
    path = tmp_path / "calib.txt"
    write_exo_calibration(path, [rectified(assembly_rig(1).exo["C10118_rgb"])])
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(FormatError, match=f"calib.txt.*{reason}"):
        read_exo_calibration(path)


def test_bytes_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_bytes(b"\xff\x00")
    with pytest.raises(FormatError, match="is no text"):
        read_exo_calibration(tmp_path / "calib.txt")


def test_skeleton_of_both_hands(tmp_path: Path) -> None:
    write_skeleton(tmp_path / "skeleton.txt")
    lines = (tmp_path / "skeleton.txt").read_text().splitlines()
    assert lines[0].startswith("#")
    assert lines[1] == "r_thumb4 0 1" and lines[4] == "r_thumb1 3 20" and lines[21] == "r_wrist 20 -1"
    assert lines[12] == "r_middle1 11 20" and lines[22] == "l_thumb4 21 22" and lines[42] == "l_wrist 41 -1"
    names, parents = zip(*read_skeleton(tmp_path / "skeleton.txt"), strict=True)
    assert len(set(names)) == 42
    expected = np.array([20 if joint % 4 == 3 else joint + 1 for joint in range(20)] + [-1])
    assert parents == (*expected, *np.where(expected < 0, -1, expected + 21))


@pytest.mark.parametrize(
    "text", ["r_wrist 0", "r_wrist 1 -1", "r_wrist 0 x", f"r_wrist 0 {'9' * 5000}", "r wrist 0 -1"]
)
def test_bad_skeletons_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "skeleton.txt").write_text(text)
    with pytest.raises(FormatError, match="is not name, 0 and parent"):
        read_skeleton(tmp_path / "skeleton.txt")
