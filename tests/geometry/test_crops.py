"""Rectified cameras, crops and remap grids: corners by hand, maps against the exact inverse."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.crops import (
    RemapGrid,
    crop_camera,
    kept_field_fraction,
    rectified,
    remap,
    source_pixels,
    square_box,
    valid_mask,
    valid_region,
)

MakeCamera = Callable[..., Camera]
CENTER_MM = np.array([200.0, -300.0, 900.0])  # 969.5 mm from the origin


def _pixels_of(camera: Camera) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(camera.width_px) * 1.0, np.arange(camera.height_px) * 1.0), axis=-1)


def test_rectified_keeps_pose_and_principal_ray(make_camera: MakeCamera) -> None:
    camera = make_camera("OpenCV", CENTER_MM)
    target = rectified(camera, focal_scale=0.8, size=(1000, 800))
    np.testing.assert_array_equal(target.T_camera_from_world, camera.T_camera_from_world)
    assert (target.fx_px, target.fy_px) == (1000.0, 992.0)
    assert (target.cx_px, target.cy_px) == (950.0 - 460.0, 545.0 - 140.0)
    assert (target.width_px, target.height_px, target.lens.model) == (1000, 800, "Pinhole")
    point = np.array([0.0, 0.0, 0.0])  # on the axis of the camera, where the lens does nothing
    np.testing.assert_allclose(camera.project(point), [950.0, 545.0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(target.project(point), [490.0, 405.0], rtol=0, atol=1e-9)


def test_crop_corners_map_to_image_corners(make_camera: MakeCamera) -> None:
    camera = make_camera("Pinhole", CENTER_MM)
    crop = crop_camera(camera, (300.0, 200.0), side_px=100.0, size_px=256)
    # the window spans [250, 350] × [150, 250] and the crop [-0.5, 255.5]²
    rays = camera.unproject(np.array([[250.0, 150.0], [350.0, 250.0], [300.0, 200.0]]))
    corners = crop.project(crop.center_world_mm + 500 * rays)
    np.testing.assert_allclose(corners, [[-0.5, -0.5], [255.5, 255.5], [127.5, 127.5]], rtol=0, atol=1e-9)
    assert crop.fx_px == pytest.approx(1250 * 2.56) and (crop.width_px, crop.height_px) == (256, 256)


def test_a_crop_of_the_whole_image_is_the_image(make_camera: MakeCamera) -> None:
    camera = make_camera("Pinhole", CENTER_MM).scaled(480, 480)
    crop = crop_camera(camera, (239.5, 239.5), side_px=480.0, size_px=480)
    np.testing.assert_allclose(crop.K, camera.K, rtol=0, atol=1e-12)


def test_impossible_crops_are_refused(make_camera: MakeCamera) -> None:
    with pytest.raises(ValueError, match="Camera a has lens OpenCV: crop its rectified camera"):
        crop_camera(make_camera("OpenCV", CENTER_MM), (1.0, 1.0), 10.0, 10)
    camera = make_camera("Pinhole", CENTER_MM)
    for center, side, size in (((np.nan, 1.0), 10.0, 10), ((1.0, 1.0), 0.0, 10), ((1.0, 1.0), 10.0, 0)):
        with pytest.raises(ValueError, match=r"Camera a: a crop of side .* does not exist"):
            crop_camera(camera, center, side, size)


def test_square_box_is_the_formula_of_the_paper() -> None:
    points = np.array([[10.0, 100.0], [30.0, 140.0], [12.0, 101.0], [np.nan, 5.0]])
    center, side = square_box(points, gamma=1.5)
    np.testing.assert_array_equal(center, [20.0, 120.0])
    assert side == 1.5 * 40.0
    with pytest.raises(ValueError, match="None of the 2 keypoints is finite"):
        square_box(np.full((2, 2), np.nan), 1.5)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)), min_size=1, max_size=21))
def test_no_keypoint_leaves_its_own_box(points: list[tuple[float, float]]) -> None:
    center, side = square_box(np.array(points), gamma=1.0)
    assert (np.abs(np.array(points) - center) <= side / 2 + 1e-9).all()


def test_source_pixels_need_a_common_centre(make_camera: MakeCamera) -> None:
    with pytest.raises(ValueError, match=r"Cameras a and a are 9\.7 mm apart"):
        source_pixels(make_camera("OpenCV", CENTER_MM), make_camera("Pinhole", CENTER_MM * 1.01), np.zeros((1, 2)))


def test_source_pixels_agree_with_projecting_points(make_camera: MakeCamera) -> None:
    for model in ("OpenCV", "OVFishEye62"):
        camera = make_camera(model, CENTER_MM)
        target = rectified(camera, 0.8)
        points = np.random.default_rng(0).uniform(-150, 150, (50, 3))
        expected = camera.project(points)
        np.testing.assert_allclose(source_pixels(camera, target, target.project(points)), expected, rtol=0, atol=1e-9)


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


def test_kept_field_and_valid_region_by_hand(make_camera: MakeCamera) -> None:
    camera = make_camera("Pinhole", CENTER_MM).scaled(640, 480)
    assert kept_field_fraction(camera, rectified(camera)) == 1.0
    # of an undistorted image, a target half as wide and high keeps a quarter, one twice as large has a black frame
    assert kept_field_fraction(camera, rectified(camera, size=(320, 240))) == pytest.approx(0.25)
    mask = valid_mask(camera, rectified(camera, size=(1280, 960)))
    assert mask.shape == (960, 1280) and mask.sum() == 640 * 480
    assert valid_region(mask) == (320, 240, 959, 719)
    with pytest.raises(ValueError, match="smaller focal scale"):
        valid_region(np.zeros((4, 4), bool))


def test_a_smaller_focal_scale_keeps_more_of_a_fisheye(make_camera: MakeCamera) -> None:
    camera = make_camera("OVFishEye62", CENTER_MM)
    kept = [kept_field_fraction(camera, rectified(camera, scale)) for scale in (1.0, 0.7, 0.4)]
    assert 0.3 < kept[0] < kept[1] < kept[2] < 1.0


def test_real_lenses_are_within_a_fiftieth_of_a_pixel(calibration_dir: Path) -> None:
    cameras = load_assembly101_calibration(sorted(calibration_dir.glob("*.json"))[0])
    for camera_id, focal_scale, step_px in (("C10095_rgb", 1.0, 8.0), ("84355350_mono10bit", 0.7, 4.0)):
        camera = cameras[camera_id]
        target = rectified(camera, focal_scale)
        grid = RemapGrid.build(camera, target)
        assert grid.step_px == step_px
        assert 1e-3 < grid.residual_px(camera, target) < 0.02
