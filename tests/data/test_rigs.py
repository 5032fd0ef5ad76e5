"""Every calibration format against hand-worked cameras, every kind of nonsense against its sentence."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from assemblyhands_core.data.rigs import MAX_CALIBRATION_BYTES, match_videos, read_calibration
from assemblyhands_core.geometry.distortion import OpenCVLens, Pinhole

QUALISYS_CAMERA = {
    "serial": "cam01",
    "active": "1",
    "fov": '<fov_video left="10" top="20" right="1097" bottom="1939"/>',
    "axes": (1, 0, 0, 0, 1, 0, 0, 0, 1),
    "center": (1000, 2000, 3000),
    "focal": (64000, 128000),
    "principal": (35200, 62080),
    "radial": (0, 0, 0),
    "tangential": (0, 0),
    "skew": "0.0",
}


def qualisys(*changes: dict, root: str = '<calibration qtm-version="2020.3" type="regular">', prolog: str = "") -> str:
    cameras = []
    for camera in (QUALISYS_CAMERA | change for change in changes or ({},)):
        rows = [f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)]
        numbers = dict(zip([*rows, *"xyz"], [*camera["axes"], *camera["center"]], strict=True))
        intrinsic = dict(zip(("focalLengthU", "focalLengthV"), camera["focal"], strict=True))
        intrinsic |= dict(zip(("centerPointU", "centerPointV"), camera["principal"], strict=True))
        intrinsic |= {f"radialDistortion{i + 1}": value for i, value in enumerate(camera["radial"])}
        intrinsic |= {f"tangentalDistortion{i + 1}": value for i, value in enumerate(camera["tangential"])}
        intrinsic |= {"skew": camera["skew"]}
        attributes = [" ".join(f'{key}="{value}"' for key, value in block.items()) for block in (numbers, intrinsic)]
        cameras.append(
            f'<camera serial="{camera["serial"]}" active="{camera["active"]}" model="none">{camera["fov"]}'
            f"<transform {attributes[0]}/><intrinsic {attributes[1]}/></camera>"
        )
    return f"<?xml version='1.0' encoding='ASCII'?>\n{prolog}{root}<cameras>{''.join(cameras)}</cameras></calibration>"


ANIPOSE_CAMERA = {
    "name": "left",
    "size": [640, 480],
    "matrix": [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]],
    "distortions": [0.0, 0.0, 0.0, 0.0, 0.0],
    "rotation": [0.0, 0.0, 0.0],
    "translation": [0.0, 0.0, 0.0],
}


def toml(*cameras: dict, more: str = "[metadata]\nadjusted = false\nerror = 0.5\n") -> str:
    tables = []
    for index, camera in enumerate(cameras):
        lines = [
            f"{key} = {json.dumps(value).replace('NaN', 'nan')}" for key, value in (ANIPOSE_CAMERA | camera).items()
        ]
        tables.append("\n".join([f"[cam_{index}]", *lines, ""]))
    return "\n".join([*tables, more])


def pair(distance: float, **extra: object) -> str:
    """Two cameras, the second's centre at (distance, 0, 0)."""
    return toml(dict(extra), {"name": "right", "translation": [-distance, 0.0, 0.0], **extra})


def saved(tmp_path: Path, content: str | bytes, name: str = "calibration.dat") -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def test_qualisys_axes_units_and_field_of_view(tmp_path: Path) -> None:
    """Qualisys' camera looks along -z with y up; here its axes are the world's, so it looks down at (1000, 2000, 0)."""
    camera = read_calibration(saved(tmp_path, qualisys()))["cam01"]
    assert (camera.width_px, camera.height_px) == (1088, 1920)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (1000.0, 2000.0, 540.0, 950.0)
    np.testing.assert_allclose(camera.center_world_mm, [1000, 2000, 3000], rtol=0, atol=1e-9)
    pixels = camera.project(np.array([[1000.0, 2000, 0], [1300, 2000, 0], [1000, 2150, 0], [1000, 2000, 4000]]))
    np.testing.assert_allclose(pixels[:3], [[540, 950], [640, 950], [540, 850]], rtol=0, atol=1e-9)
    assert np.isnan(pixels[3]).all()
    assert isinstance(camera.lens, Pinhole)


def test_qualisys_rows_are_the_camera_axes(tmp_path: Path) -> None:
    """Axes right = world y, up = world z, backward = world x: the camera at the origin looks along -x."""
    text = qualisys({"axes": (0, 1, 0, 0, 0, 1, 1, 0, 0), "center": (0, 0, 0)})
    camera = read_calibration(saved(tmp_path, text))["cam01"]
    pixels = camera.project(np.array([[-1000.0, 0, 0], [-1000, 100, 0], [-1000, 0, 100]]))
    np.testing.assert_allclose(pixels, [[540, 950], [640, 950], [540, 750]], rtol=0, atol=1e-9)


def test_qualisys_distortion_is_as_written_and_marker_cameras_are_kept(tmp_path: Path) -> None:
    marker = {"serial": "23087", "fov": '<fov_marker left="0" top="0" right="99" bottom="49"/>'}
    lens = {"radial": ("-0.05", "0.14", "0.01"), "tangential": ("0.001", "-0.002")}
    cameras = read_calibration(
        saved(tmp_path, qualisys(lens, marker, {"serial": "off", "active": "0", "focal": (0, 0)}))
    )
    assert list(cameras) == ["cam01", "23087"]
    assert cameras["cam01"].lens == OpenCVLens(k1=-0.05, k2=0.14, k3=0.01, p1=0.001, p2=-0.002)
    assert (cameras["23087"].width_px, cameras["23087"].height_px) == (100, 50)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_encodings_of_windows_are_read(tmp_path: Path, encoding: str) -> None:
    text = qualisys().replace("ASCII", encoding.removesuffix("-sig"))
    assert list(read_calibration(saved(tmp_path, text.encode(encoding)))) == ["cam01"]


def test_anipose_pose_and_lens_are_those_of_opencv(tmp_path: Path) -> None:
    camera = {
        "distortions": [-0.2, 0.05, 0.001, -0.002, 0.01],
        "rotation": [0.3, -0.8, 1.9],
        "translation": [30.0, -20.0, 1500.0],
    }
    read = read_calibration(saved(tmp_path, toml(camera)), unit="mm")["left"]
    points = np.random.default_rng(0).uniform(-300, 300, (50, 3))
    expected, _ = cv2.projectPoints(
        points,
        np.array(camera["rotation"]),
        np.array(camera["translation"]),
        np.array(ANIPOSE_CAMERA["matrix"]),
        np.array(camera["distortions"]),
    )
    np.testing.assert_allclose(read.project(points), expected[:, 0], rtol=0, atol=1e-8)
    assert (read.width_px, read.height_px) == (640, 480)


def test_a_rotation_of_nothing_is_the_identity(tmp_path: Path) -> None:
    camera = read_calibration(saved(tmp_path, toml({})), unit="mm")["left"]
    np.testing.assert_array_equal(camera.T_camera_from_world, np.eye(4))


@pytest.mark.parametrize(
    ("text", "unit", "distance_mm"),
    [
        (pair(2.5, fisheye=False), "auto", 2500.0),
        (pair(2500.0, fisheye=False), "auto", 2500.0),
        (pair(2500.0), "auto", 2500.0),
        (pair(2.5), "m", 2500.0),
        (pair(2.5), "mm", 2.5),
        (pair(2500.0), "m", 2.5e6),
    ],
)
def test_the_unit_of_toml_files(tmp_path: Path, text: str, unit: str, distance_mm: float) -> None:
    cameras = read_calibration(saved(tmp_path, text), unit=unit)
    np.testing.assert_allclose(cameras["right"].center_world_mm, [distance_mm, 0, 0], rtol=1e-12, atol=1e-9)


def test_an_unclear_unit_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"unit of length is unclear .*up to 2.5 units apart.*ingest\.length_unit=mm or m"
    ):
        read_calibration(saved(tmp_path, pair(2.5)))


def test_assembly101_is_recognised_whatever_the_name(tmp_path: Path) -> None:
    record = {"SerialNo": "C1", "DistortionModel": "OpenCV", "ImageSizeX": 1920, "ImageSizeY": 1080}
    record |= {"fx": 1200.0, "fy": 1201.0, "cx": 950.0, "cy": 530.0, "ModelViewMatrix": np.eye(4).tolist()}
    record |= dict.fromkeys(("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "p3", "p4"), 0.0)
    for content in ([{"Camera": record}], record):
        cameras = read_calibration(saved(tmp_path, " \n" + json.dumps(content), "calibration.toml"))
        assert list(cameras) == ["C1"] and cameras["C1"].fy_px == 1201.0


def test_a_calib_txt_of_the_release_is_recognised_by_content(tmp_path: Path) -> None:
    pose = [[1.0, 0.0, 0.0, -5.0], [0.0, 1.0, 0.0, 2.5], [0.0, 0.0, 1.0, 900.0]]
    rows = [[1200.0, 0.0, 959.5], [0.0, 1210.0, 539.5], [0.0, 0.0, 1.0], [0.0] * 5, *pose]
    text = "\n".join(" ".join(map(str, row)) for row in rows)
    path = tmp_path / "whatever.dat"
    path.write_text(f"C10095_rgb\n{text}\n\nC10115_rgb\n{text}\n")
    cameras = read_calibration(path)
    assert list(cameras) == ["C10095_rgb", "C10115_rgb"] and cameras["C10095_rgb"].lens == Pinhole()
    assert (cameras["C10095_rgb"].fx_px, cameras["C10095_rgb"].fy_px) == (1200.0, 1210.0)
    np.testing.assert_array_equal(cameras["C10115_rgb"].T_camera_from_world[:3], pose)


def test_real_assembly101_calibrations_are_read(calibration_dir: Path) -> None:
    path = min(calibration_dir.glob("*.json"))
    assert len(read_calibration(path)) == 12


JSON_KEYS = (
    *("DistortionModel", "ImageSizeX", "ImageSizeY", "fx", "fy", "cx", "cy", "ModelViewMatrix"),
    *("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"),
)
NONSENSE = {
    "empty": ("", "is empty; supported are Assembly101 JSON"),
    "blank": (" \n\t", "is empty"),
    "binary": (b"\x00\x01\x02\xff" * 64, "is binary"),
    "other_text": ("1 2 3\n4 5 6\n", "no well-formed TOML"),
    "other_toml": ("[project]\nname = 'x'\n", "holds no camera; supported are"),
    "no_cameras": (qualisys().replace("<camera s", "<camer s").replace("</camera>", "</camer>"), "holds no camera"),
    "broken_json": ('[{"Camera": ', "no JSON"),
    "endless_json": ('[{"a":' + "[" * 200_000, "nested without end"),
    "broken_xml": (qualisys()[:300], "no well-formed XML"),
    "other_xml": ("<html></html>", "its root <html> is no Qualisys"),
    "theia": (qualisys(root="<calibration>"), "is no Qualisys <calibration qtm-version"),
    "entity_bomb": (qualisys(prolog='<!DOCTYPE a [<!ENTITY b "c">]>'), "DOCTYPE"),
    "qualisys_nan": (qualisys({"focal": ("nan", 1)}), "camera cam01 is refused: .*focalLengthU is 'nan'"),
    "qualisys_word": (qualisys({"center": ("x", 0, 0)}), "camera cam01 is refused: <transform> x is 'x'"),
    "qualisys_zero_focal": (qualisys({"focal": (0, 6400)}), "camera cam01.*fx_px is 0"),
    "qualisys_axes": (qualisys({"axes": (1, 0, 0, 0, 1, 0, 0, 0, 1.01)}), "camera cam01.*not orthonormal"),
    "qualisys_mirror": (qualisys({"axes": (1, 0, 0, 0, 1, 0, 0, 0, -1)}), "camera cam01.*mirror"),
    "qualisys_size": (qualisys({"fov": QUALISYS_CAMERA["fov"].replace("1097", "9")}), "camera cam01.*width_px is 0"),
    "qualisys_no_fov": (qualisys({"fov": ""}), "camera cam01.*lacks <fov_marker>"),
    "qualisys_skew": (qualisys({"skew": "3.0"}), "camera cam01.*skewed"),
    "qualisys_twice": (qualisys({}, {}), "'cam01' is double"),
    "qualisys_nameless": (qualisys({"serial": ""}), "serial '' is missing"),
    "anipose_fisheye": (toml({"fisheye": True}), "camera left is refused: fisheye = true"),
    "anipose_nan": (toml({"translation": [0.0, float("nan"), 0.0]}), "camera left.*translation is .*nan"),
    "anipose_text": (toml({"rotation": "none"}), "camera left.*rotation is none instead of 3 finite numbers"),
    "anipose_shape": (toml({"matrix": [1.0, 2.0]}), "camera left.*matrix is .* instead of 3 x 3 finite numbers"),
    "anipose_skew": (toml({"matrix": [[500, 9, 320], [0, 500, 240], [0, 0, 1]]}), r"instead of \[\[fx, 0, cx\]"),
    "anipose_transposed": (toml({"matrix": [[500, 0, 0], [0, 500, 0], [320, 240, 1]]}), r"instead of \[\[fx, 0, cx\]"),
    "anipose_zero_focal": (toml({"matrix": [[0, 0, 320], [0, 500, 240], [0, 0, 1]]}), "camera left.*fx_px is 0"),
    "anipose_size": (toml({"size": [0, 480]}), "camera left.*width_px is 0"),
    "anipose_prism": (toml({"distortions": [0.0] * 8 + [0.1] * 4}), "thin prism"),
    "anipose_twice": (toml({}, {}), "camera left occurs twice"),
    "anipose_huge_number": (toml({"translation": [10**400, 0, 0]}), "camera left.*translation is .* 3 finite numbers"),
    "anipose_overflow": (toml({"rotation": [1e308, 1e308, 0.0]}), "camera left.*rotation is .* 3 finite numbers"),
    "anipose_digits": ("a = " + "9" * 5000, "no well-formed TOML"),
    "anipose_deep": ("a = " + "[" * 5000, "no well-formed TOML"),
    "anipose_dots": ("a" + ".a" * 2_000_000 + " = 1", "a line of more than 1000 dots"),
    "anipose_cameras": (toml(*({"name": f"c{i}"} for i in range(1001))), "1001 tables of cameras"),
    "giant_pictures": (toml({"size": [1e8, 1e8]}), "camera 'left': no picture has 100000000×100000000 px"),
    "leaves_its_folder": (toml({"name": "/tmp/left"}), "camera ./tmp/left.: its name becomes part of file names"),
    "hidden": (toml({"name": ".left"}), "its name becomes part of file names"),
    "control_characters": (toml({"name": "a\x1b[2J"}), r"camera 'a\\x1b\[2J': its name becomes part"),
    "qualisys_span": (
        qualisys({"fov": '<fov_video left="-1e308" top="0" right="1e308" bottom="1"/>'}),
        "instead of a finite number",
    ),
    "json_deep": ("[" * 3000 + "{", "supported are"),
    "json_deeper": ('[{"a":' + "[" * 50000, "nested without end"),
    "json_digits": ('[{"a":' + "9" * 5000 + "}]", "this is no JSON"),
    "json_huge_number": (
        json.dumps([{"SerialNo": "a", **dict.fromkeys(JSON_KEYS, 10**400)}]),
        "camera a is refused: .* finite number",
    ),
    "json_huge_pose": (
        json.dumps(
            [
                {
                    "SerialNo": "a",
                    **dict.fromkeys(JSON_KEYS, 1),
                    "DistortionModel": "OpenCV",
                    "k4": 0,
                    "k5": 0,
                    "k6": 0,
                    "ModelViewMatrix": [[10**400]],
                }
            ]
        ),
        "camera a is refused: ModelViewMatrix is no 4x4",
    ),
    "json_name": ('[{"SerialNo": "a\\ud800"}]', r"camera 'a.ud800' has signs in its name that cannot be written"),
    "json_word": (
        json.dumps([{"SerialNo": "a", **dict.fromkeys(JSON_KEYS, "\ud800")}]),
        r"camera a is refused: k1 is '.ud800' inst",
    ),
    "json_cameras": (json.dumps([{}] * 1001), "has 1001 records"),
    "anipose_incomplete": (toml({}).replace("translation", "t"), "camera left is refused: it lacks translation"),
}


@pytest.mark.parametrize("case", NONSENSE)
def test_nonsense_gets_one_sentence_with_the_file(tmp_path: Path, case: str) -> None:
    content, message = NONSENSE[case]
    with pytest.raises(ValueError, match=message) as caught:
        read_calibration(saved(tmp_path, content, f"{case}.txt"), unit="mm")
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / case}.txt: ") and text.endswith(".") and "\n" not in text and ".." not in text
    assert len(text) < 450


def test_missing_and_huge_files_are_refused_without_reading(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"absent\.toml: no such file; check rig\.calibration"):
        read_calibration(tmp_path / "absent.toml")
    with pytest.raises(ValueError, match="no such file"):
        read_calibration(tmp_path)
    with (tmp_path / "huge.json").open("wb") as file:
        file.truncate(MAX_CALIBRATION_BYTES + 1)
    with pytest.raises(ValueError, match=r"huge\.json: 4 MiB is no calibration"):
        read_calibration(tmp_path / "huge.json")


@pytest.mark.parametrize(
    ("video", "camera"),
    [
        ("cam01", "cam01"),
        ("CAM_01", "cam01"),
        ("cam-01", "cam01"),
        ("Miqus_3_23087", "23087"),
        ("take2_cam01_rgb", "cam01"),
        ("cam1", None),
        ("cam011", None),
        ("take_23087_cam01", None),
        ("123087", None),
    ],
)
def test_videos_are_matched_by_name(video: str, camera: str | None) -> None:
    path = Path(f"videos/{video}.mp4")
    match = match_videos([path], ["cam01", "23087", "cam02"])
    assert match.video_by_camera == ({camera: path} if camera else {})
    assert set(match.problems) == (set() if camera else {path})


def test_ambiguous_videos_are_named_and_left_out() -> None:
    paths = [Path("a/cam01.mp4"), Path("b/cam01.mp4"), Path("a/cam02.mp4"), Path("a/other.mp4")]
    match = match_videos(paths, ["cam02", "cam01", "cam03"])
    assert match.video_by_camera == {"cam02": Path("a/cam02.mp4")}
    assert "several videos claim camera cam01 (a/cam01.mp4, b/cam01.mp4)" in match.problems[paths[0]]
    assert "has the name of no camera of the calibration (cam02, cam01, cam03)" in match.problems[paths[3]]
    assert set(match.problems) == {paths[0], paths[1], paths[3]}
