"""Cameras: hand-worked pixels, exact inverses, and calibrations that are refused for a named reason."""

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.distortion import OpenCVLens, OVFishEye62, Pinhole

# x_camera = z_world, y_camera = x_world, z_camera = y_world, then moved
POSE = transforms.rigid(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([10.0, 20.0, 500.0]))


def _camera(lens: Any = None, **changes: Any) -> Camera:
    camera = Camera("left", 640, 480, 400.0, 410.0, 320.0, 240.0, lens or Pinhole(), POSE)
    return replace(camera, **changes)


def test_a_pinhole_point_by_hand() -> None:
    # world (30, 500, 90) is camera (100, 50, 1000): 400·0.1 + 320, 410·0.05 + 240
    camera = _camera()
    point = np.array([30.0, 500.0, 90.0])
    np.testing.assert_array_equal(camera.to_camera(point), [100.0, 50.0, 1000.0])
    assert camera.depth_mm(point) == 1000.0
    np.testing.assert_allclose(camera.project(point), [360.0, 260.5], rtol=0, atol=1e-12)
    np.testing.assert_allclose(camera.center_world_mm, [-20.0, -500.0, -10.0], rtol=0, atol=1e-12)
    direction = point - camera.center_world_mm
    ray = camera.unproject(np.array([360.0, 260.5]))
    np.testing.assert_allclose(ray, direction / np.linalg.norm(direction), rtol=0, atol=1e-15)
    homogeneous = camera.P_pixel_from_world @ np.append(point, 1.0)
    np.testing.assert_allclose(homogeneous, [360_000.0, 260_500.0, 1000.0], rtol=1e-14)


def test_opencv_and_fisheye_points_by_hand() -> None:
    point = np.array([-20.0, 500.0, 490.0])  # camera (500, 0, 1000)
    opencv = _camera(OpenCVLens(k1=0.4, p1=0.01, p2=0.02))  # normalised (0.565, 0.0025), see test_distortion
    np.testing.assert_allclose(opencv.project(point), [400 * 0.565 + 320, 410 * 0.0025 + 240], rtol=0, atol=1e-12)
    fisheye = _camera(OVFishEye62(k1=0.5))
    angle = np.arctan(0.5)
    expected = [400 * angle * (1 + 0.5 * angle**2) + 320, 240.0]
    np.testing.assert_allclose(fisheye.project(point), expected, rtol=0, atol=1e-12)


def test_no_matrix_describes_a_distorting_lens() -> None:
    with pytest.raises(ValueError, match="Camera left has lens OpenCV, which no matrix describes: use its rectified"):
        _ = _camera(OpenCVLens(k1=0.1)).P_pixel_from_world


def test_points_behind_are_missing() -> None:
    assert np.isnan(_camera().project(np.array([0.0, -501.0, 0.0]))).all()
    assert np.isfinite(_camera().project(np.array([0.0, -499.0, 0.0]))).all()


@pytest.mark.parametrize("model", ["Pinhole", "OpenCV", "OVFishEye62"])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(x=st.floats(0.0, 1.0), y=st.floats(0.0, 1.0), depth=st.floats(100.0, 3000.0), seed=st.integers(0, 20))
def test_project_undoes_unproject_over_the_whole_image(
    make_camera: Callable[..., Camera], model: str, x: float, y: float, depth: float, seed: int
) -> None:
    center = np.random.default_rng(seed).normal(0, 600, 3)
    camera = make_camera(model, center)
    pixel = np.array([x * camera.width_px - 0.5, y * camera.height_px - 0.5])
    ray = camera.unproject(pixel)
    assert abs(np.linalg.norm(ray) - 1) < 1e-14
    np.testing.assert_allclose(camera.project(camera.center_world_mm + depth * ray), pixel, rtol=0, atol=1e-7)


def test_pixels_outside_the_field_have_no_ray() -> None:
    camera = _camera(OpenCVLens(k1=-1 / 3))  # the image ends at 2/3 of the focal length
    rays = camera.unproject(np.array([[320.0 + 0.66 * 400, 240.0], [320.0 + 0.67 * 400, 240.0], [np.nan, 0.0]]))
    assert np.isfinite(rays[0]).all() and np.isnan(rays[1:]).all()


def test_types_follow_the_input() -> None:
    for lens in (Pinhole(), OpenCVLens(k1=0.1), OVFishEye62(k1=0.1)):
        camera = _camera(lens)
        for dtype in (np.float32, np.float64):
            pixels = camera.project(np.zeros((3, 2, 3), dtype))
            assert pixels.dtype == dtype and pixels.shape == (3, 2, 2)
            rays = camera.unproject(pixels)
            assert rays.dtype == dtype and rays.shape == (3, 2, 3)
        assert camera.project(np.zeros((1, 3), int)).dtype == np.float64


def test_the_image_spans_half_a_pixel_more_on_each_side() -> None:
    pixels = np.array([[-0.5, -0.5], [639.5, 479.5], [-0.51, 0.0], [0.0, 479.51], [np.nan, 0.0]])
    np.testing.assert_array_equal(_camera().contains(pixels), [True, True, False, False, False])


def test_scaled_keeps_the_corners_of_the_image() -> None:
    camera = _camera(OpenCVLens(k1=0.1))
    half = camera.scaled(320, 120)
    corners = np.array([[-0.5, -0.5], [639.5, 479.5]])
    expected = camera.unproject(corners)
    np.testing.assert_allclose(half.unproject(np.array([[-0.5, -0.5], [319.5, 119.5]])), expected, rtol=0, atol=1e-12)
    assert (half.cx_px, half.cy_px, half.fx_px, half.fy_px) == (159.75, 59.625, 200.0, 102.5)


def test_moved_changes_the_pose_only() -> None:
    moved = _camera().moved(np.eye(4))
    np.testing.assert_array_equal(moved.project(np.array([100.0, 50.0, 1000.0])), [360.0, 260.5])
    assert (moved.camera_id, moved.fx_px) == ("left", 400.0)


def test_a_camera_travels_to_another_process(make_rig: Callable[..., list[Camera]]) -> None:
    point = np.array([10.0, 20.0, 30.0])
    for camera in make_rig(3, ("Pinhole", "OpenCV", "OVFishEye62")):
        pixel = camera.project(point)
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(camera)).project(point), pixel)


def test_a_pose_cannot_be_changed_by_accident() -> None:
    pose = POSE.copy()
    camera = _camera(T_camera_from_world=pose)
    pose[0, 3] = 99.0
    assert camera.T_camera_from_world[0, 3] == 10.0
    with pytest.raises(ValueError, match="read-only"):
        camera.T_camera_from_world[0, 3] = 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx_px": -1.0}, "fx_px is -1.0"),
        ({"width_px": 0}, "width_px is 0"),
        ({"cx_px": float("nan")}, "cx_px is nan"),
        ({"T_camera_from_world": np.eye(4) * 2}, "its pose is refused"),
    ],
)
def test_impossible_cameras_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"Camera left: {message}"):
        _camera(**changes)


def _block(**changes: Any) -> dict[str, Any]:
    block = {
        "DistortionModel": "OpenCV",
        "ImageSizeX": 640,
        "ImageSizeY": 480,
        "ModelViewMatrix": POSE.tolist(),
        "SerialNo": "C1",
        "fx": 400.0,
        "fy": 410.0,
        "cx": 320.0,
        "cy": 240.0,
        **{f"k{i}": 0.0 for i in range(1, 7)},
        **{f"p{i}": 0.0 for i in range(1, 5)},
    }
    return {key: value for key, value in (block | changes).items() if value is not None}


def _write(tmp_path: Path, document: Any) -> Path:
    path = tmp_path / "calibration.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


def test_calibration_with_and_without_record_wrappers(tmp_path: Path) -> None:
    fisheye = _block(SerialNo="E1", DistortionModel="OVFishEye62", k1=0.25, k6=0.02, p1=1e-3, p2=2e-3)
    wrapped = {"Camera": _block(k1=-0.1, k3=0.02, p1=3e-4), "MountingLocation": "Exocentric", "Type": "x"}
    cameras = load_assembly101_calibration(_write(tmp_path, [fisheye, wrapped]))
    assert list(cameras) == ["E1", "C1"]
    assert cameras["C1"].lens == OpenCVLens(k1=-0.1, k3=0.02, p1=3e-4)
    assert cameras["E1"].lens == OVFishEye62(k1=0.25, k6=0.02, p1=1e-3, p2=2e-3)
    np.testing.assert_array_equal(cameras["C1"].T_camera_from_world, POSE)
    assert (cameras["C1"].width_px, cameras["C1"].height_px, cameras["C1"].camera_id) == (640, 480, "C1")
    np.testing.assert_array_equal(cameras["C1"].K, [[400.0, 0.0, 320.0], [0.0, 410.0, 240.0], [0.0, 0.0, 1.0]])


SKEWED = [[1.0, 0.1, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{not json", "this is no JSON .*: export the calibration again"),
        ("[]", "expected a JSON list of camera records"),
        ('"text"', "expected a JSON list of camera records, got str"),
        ("[3]", "record 0 is no JSON object"),
        ([_block(), _block()], "camera C1 occurs twice: remove one"),
        ([_block(fx=None)], "camera C1 is refused: it lacks fx"),
        ([_block(SerialNo=None)], "camera record 0 is refused: it lacks SerialNo"),
        ([_block(cx=float("nan"))], "camera C1 is refused: cx is nan"),
        ([_block(k1=float("inf"))], "camera C1 is refused: k1 is inf"),
        ([_block(fy="410")], "camera C1 is refused: fy is '410'"),
        ([_block(fx=-400.0)], "fx_px is -400.0"),
        ([_block(ModelViewMatrix=SKEWED)], "camera C1 .*not orthonormal .* calibrate it again"),
        ([_block(ModelViewMatrix=[[1, 2], [3]])], "ModelViewMatrix is no 4x4"),
        ([_block(ModelViewMatrix=np.full((4, 4), np.nan).tolist())], "camera C1 .*NaN or infinity"),
        ([_block(DistortionModel="Kannala")], "'Kannala' is not supported: use one of Pinhole, OpenCV, OVFishEye62"),
        ([_block(p3=0.1)], "Lens model OpenCV has no p3=0.1"),
        ([_block(k4=0.1)], "k4, k5, k6 of its OpenCV lens are not 0"),
    ],
)
def test_bad_calibrations_get_one_sentence(tmp_path: Path, document: Any, message: str) -> None:
    path = _write(tmp_path, document)
    with pytest.raises(ValueError, match=message) as error:
        load_assembly101_calibration(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_real_calibrations_load_whole(calibration_dir: Path) -> None:
    for path in sorted(calibration_dir.glob("*.json")):
        cameras = load_assembly101_calibration(path)
        models = [camera.lens.model for camera in cameras.values()]
        assert (models.count("OpenCV"), models.count("OVFishEye62")) == (8, 4)


def test_every_pixel_of_the_real_cameras_has_a_ray_and_comes_back(calibration_dir: Path) -> None:
    path = sorted(calibration_dir.glob("*.json"))[0]
    for camera in load_assembly101_calibration(path).values():
        x = np.linspace(-0.5, camera.width_px - 0.5, 97)
        y = np.linspace(-0.5, camera.height_px - 0.5, 61)
        pixels = np.stack(np.meshgrid(x, y), axis=-1)
        back = camera.project(camera.center_world_mm + 700 * camera.unproject(pixels))
        assert np.abs(back - pixels).max() < 1e-7, camera.camera_id
