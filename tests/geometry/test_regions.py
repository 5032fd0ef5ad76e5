"""Remap grids and the regions that they cut: maps against the exact inverse."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.crops import (
    crop_camera,
    rectified,
    source_pixels,
)
from assemblyhands_core.geometry.regions import RemapGrid, remap

MakeCamera = Callable[..., Camera]
CENTER_MM = np.array([200.0, -300.0, 900.0])  # 969.5 mm from the origin


def _pixels_of(camera: Camera) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(camera.width_px) * 1.0, np.arange(camera.height_px) * 1.0), axis=-1)


@pytest.mark.parametrize(("model", "focal_scale"), [("OpenCV", 1.0), ("OVFishEye62", 0.7)])
def test_window_maps_stay_within_the_measured_residual(make_camera: MakeCamera, model: str, focal_scale: float) -> None:
    camera = make_camera(model, CENTER_MM)
    target = rectified(camera, focal_scale)
    grid = RemapGrid.build(camera, target)
    assert 1e-4 < grid.residual_px(camera, target) <= 0.02
    for center, side in (((300.0, 200.0), 333.0), ((5.0, 470.0), 90.0), ((600.5, 20.25), 400.0)):
        crop = crop_camera(target, center, side, 64)
        exact = source_pixels(camera, crop, _pixels_of(crop))
        seen = camera.contains(exact)
        error = np.linalg.norm(np.stack(grid.window(crop), axis=-1) - exact, axis=-1)
        assert error[seen].max() < grid.residual_px(camera, target) + 1e-3
        assert seen.any()


def test_a_bilinear_grid_errs_by_its_step_squared(make_camera: MakeCamera) -> None:
    camera = make_camera("OVFishEye62", CENTER_MM)
    target = rectified(camera, 0.7)
    coarse, fine = (RemapGrid.build(camera, target, step, np.inf).residual_px(camera, target) for step in (8.0, 4.0))
    assert coarse / fine == pytest.approx(4.0, rel=0.1)


def test_build_halves_the_step_until_the_residual_is_allowed(make_camera: MakeCamera) -> None:
    camera = make_camera("OVFishEye62", CENTER_MM)
    assert RemapGrid.build(camera, rectified(camera, 0.7)).step_px == 4.0
    assert RemapGrid.build(camera, rectified(camera, 0.7), max_residual_px=0.1).step_px == 8.0


def test_maps_point_off_the_image_where_there_is_no_source(make_camera: MakeCamera) -> None:
    camera = make_camera("OVFishEye62", CENTER_MM)
    target = rectified(camera, 0.7)
    crop = crop_camera(target, (5000.0, 200.0), 100.0, 16)
    map_x, map_y = RemapGrid.build(camera, target).window(crop)
    assert (map_x < -1000).all() and (map_y < -1000).all()
    image = np.full((camera.height_px, camera.width_px), 255, np.uint8)
    assert (remap(image, map_x, map_y) == 0).all()


def test_remap_shows_what_the_crop_camera_would_see(make_camera: MakeCamera) -> None:
    camera = make_camera("OpenCV", CENTER_MM)
    target = rectified(camera)
    # an image that is linear in the pixel, so that its value tells the source pixel
    x, y = np.moveaxis(_pixels_of(camera), -1, 0)
    image = np.stack((x, y), axis=-1).astype(np.float32)
    crop = crop_camera(target, (900.0, 500.0), 200.0, 128)
    seen = remap(image, *RemapGrid.build(camera, target).window(crop))
    points = crop.center_world_mm + 800 * crop.unproject(_pixels_of(crop))
    # cv2.remap rounds source positions to 1/32 px
    assert np.abs(seen - camera.project(points)).max() < 1 / 32


def test_grids_are_stored_bit_for_bit(make_camera: MakeCamera) -> None:
    camera = make_camera("OVFishEye62", CENTER_MM)
    target = rectified(camera, 0.7)
    grid = RemapGrid.build(camera, target)
    data = grid.to_bytes()
    back = RemapGrid.from_bytes(data)
    assert back.to_bytes() == data == RemapGrid.build(camera, target).to_bytes()
    crop = crop_camera(target, (300.0, 200.0), 150.0, 32)
    np.testing.assert_array_equal(back.window(crop), grid.window(crop))
    for damaged in (data[:-1], data[:40], b""):
        with pytest.raises(ValueError, match="cut off"):
            RemapGrid.from_bytes(damaged)


def test_real_lenses_are_within_a_fiftieth_of_a_pixel(calibration_dir: Path) -> None:
    cameras = load_assembly101_calibration(sorted(calibration_dir.glob("*.json"))[0])
    for camera_id, focal_scale, step_px in (("C10095_rgb", 1.0, 8.0), ("84355350_mono10bit", 0.7, 4.0)):
        camera = cameras[camera_id]
        target = rectified(camera, focal_scale)
        grid = RemapGrid.build(camera, target)
        assert grid.step_px == step_px
        assert 1e-3 < grid.residual_px(camera, target) < 0.02
