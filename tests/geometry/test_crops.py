"""Rectified cameras and crops: corners by hand."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import (
    crop_camera,
    kept_field_fraction,
    rectified,
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
