"""Parity of cameras with the reference toolkit, by the largest error over all cameras and points."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.crops import crop_camera, rectified, source_pixels
from assemblyhands_core.geometry.regions import RemapGrid

MAX_PIXEL_ERROR_PX = 1e-6
MAX_RAY_ERROR = 1e-7


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> dict[str, np.ndarray]:
    return dict(np.load(golden_dir / "camera_project.npz"))


@pytest.fixture(scope="module")
def rigs(golden: dict[str, np.ndarray], calibration_dir: Path) -> list[dict[str, Camera]]:
    return [load_assembly101_calibration(calibration_dir / f"{name}.json") for name in golden["seq"]]


def _cameras(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> Iterator[tuple[tuple[int, int], Camera]]:
    for sequence, rig in enumerate(rigs):
        for view, serial in enumerate(golden["serial"][sequence]):
            yield (sequence, view), rig[str(serial)]


def test_every_camera_is_compared(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    cameras = [camera for _, camera in _cameras(golden, rigs)]
    assert len(cameras) == 240
    for at, camera in _cameras(golden, rigs):
        assert camera.lens.model == golden["distortion_model"][at]
        assert (camera.width_px, camera.height_px) == tuple(golden["image_size"][at])


def test_project(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    for at, camera in _cameras(golden, rigs):
        error = np.abs(camera.project(golden["points_world"][at]) - golden["pixels"][at]).max()
        assert error < MAX_PIXEL_ERROR_PX, camera.camera_id
        depth = camera.depth_mm(golden["points_world"][at])
        np.testing.assert_allclose(depth, golden["points_eye"][at][..., 2], rtol=0, atol=1e-9)


def test_single_precision_is_good_to_a_fiftieth_of_a_pixel(
    golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]
) -> None:
    for at, camera in _cameras(golden, rigs):
        pixels = camera.project(golden["points_world"][at].astype(np.float32))
        assert pixels.dtype == np.float32
        assert np.abs(pixels - golden["pixels"][at]).max() < 2e-2, camera.camera_id


def test_unproject(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    for at, camera in _cameras(golden, rigs):
        rays = camera.unproject(golden["unproj_pixels"][at])
        assert np.abs(rays - golden["unproj_rays_world"][at]).max() < MAX_RAY_ERROR, camera.camera_id
        back = camera.project(camera.center_world_mm + 500 * rays)
        assert np.abs(back - golden["unproj_pixels"][at]).max() < MAX_PIXEL_ERROR_PX, camera.camera_id
        np.testing.assert_allclose(camera.center_world_mm, golden["camera_center_world"][at], rtol=0, atol=1e-9)


def test_rectify_map(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    for at, camera in _cameras(golden, rigs):
        target = rectified(camera, float(golden["rectify_focal_scale"][at]))
        source = source_pixels(camera, target, golden["rectify_pixels"][at])
        assert np.abs(source - golden["rectify_src_pixels"][at]).max() < MAX_PIXEL_ERROR_PX, camera.camera_id


def test_rectify_grid(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    for at, camera in _cameras(golden, rigs[:1]):
        target = rectified(camera, float(golden["rectify_focal_scale"][at]))
        grid = RemapGrid.build(camera, target)
        source = golden["rectify_src_pixels"][at]
        # a crop of one pixel samples the map at its centre
        single = [crop_camera(target, pixel, side_px=1.0, size_px=1) for pixel in golden["rectify_pixels"][at]]
        found = np.array([np.ravel(grid.window(crop)) for crop in single])
        seen = camera.contains(source)
        assert seen.sum() >= 6
        assert np.abs(found - source)[seen].max() < 0.02, camera.camera_id


def test_moving_camera(golden: dict[str, np.ndarray], rigs: list[dict[str, Camera]]) -> None:
    for sequence, rig in enumerate(rigs):
        for view, serial in enumerate(golden["moving_serial"][sequence]):
            camera = rig[str(serial)].moved(golden["moving_model_view"][sequence, view])
            pixels = camera.project(golden["moving_points_world"][sequence, view])
            error = np.abs(pixels - golden["moving_pixels"][sequence, view]).max()
            assert error < MAX_PIXEL_ERROR_PX, camera.camera_id
