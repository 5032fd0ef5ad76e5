"""Triangulation: exact without noise, honest with outliers, unmoved by what must not matter."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.reasons import Reason
from assemblyhands_core.geometry.triangulation import triangulate

MakeRig = Callable[..., list[Camera]]
ALL_LENSES = ("Pinhole", "OpenCV", "OVFishEye62")


def _points(num_points: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-150, 150, (num_points, 3))


def _observe(points: np.ndarray, cameras: list[Camera], noise_px: float = 0.0, seed: int = 1) -> np.ndarray:
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1)
    return np.asarray(pixels + np.random.default_rng(seed).normal(0, noise_px, pixels.shape))


def _displace(pixels: np.ndarray, share: float, seed: int = 2) -> np.ndarray:
    """Move a share of the pixels by 60 to 300 px in place and return which, `(P, V)`, at least 4 views left."""
    generator = np.random.default_rng(seed)
    is_outlier = generator.random(pixels.shape[:2]) < share
    is_outlier[:, :4] = False
    angle = generator.uniform(0, 2 * np.pi, is_outlier.sum())
    size = generator.uniform(60, 300, is_outlier.sum())
    pixels[is_outlier] += size[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return np.asarray(is_outlier)


@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize("num_views", [2, 3, 8, 16, 33])
def test_exact_pixels_give_exact_points(make_rig: MakeRig, robust: bool, num_views: int) -> None:
    cameras, points = make_rig(num_views, ALL_LENSES), _points(40)
    found = triangulate(_observe(points, cameras), cameras, robust=robust)
    assert (found.status == "ok").all() and found.valid.all()
    assert found.is_inlier.all() and (found.num_views == num_views).all()
    np.testing.assert_allclose(found.points_world_mm, points, rtol=0, atol=1e-6)
    assert found.reprojection_px.max() < 1e-6


def test_two_rays_by_hand() -> None:
    # cameras at (∓100, 0, 0) look along z; the point (0, 50, 1000) is at 320 ± 100·500/1000 and 240 + 50·500/1000
    cameras = [_forward_camera(-100.0), _forward_camera(100.0)]
    pixels = np.array([[[370.0, 265.0], [270.0, 265.0]]])
    for robust in (True, False):
        found = triangulate(pixels, cameras, robust=robust)
        np.testing.assert_allclose(found.points_world_mm, [[0.0, 50.0, 1000.0]], rtol=0, atol=1e-9)


def _forward_camera(x_mm: float) -> Camera:
    from assemblyhands_core.geometry.distortion import Pinhole

    pose = transforms.rigid(np.eye(3), np.array([-x_mm, 0.0, 0.0]))
    return Camera(f"x{x_mm}", 640, 480, 500.0, 500.0, 320.0, 240.0, Pinhole(), pose)


@pytest.mark.parametrize("num_views", [8, 16])
def test_outliers_are_found_exactly(make_rig: MakeRig, num_views: int) -> None:
    cameras, points = make_rig(num_views, ("OpenCV",)), _points(300)
    pixels = _observe(points, cameras, noise_px=1.0)
    is_outlier = _displace(pixels, share=0.3)
    found = triangulate(pixels, cameras)
    assert is_outlier.sum() > 200
    assert (found.status == Reason.OK).all()
    np.testing.assert_array_equal(found.is_inlier, ~is_outlier)
    assert (found.reprojection_px[is_outlier] > 10).all()
    # without the outlying views at all: the same points, so outliers had no pull left
    without = pixels.copy()
    without[is_outlier] = np.nan
    np.testing.assert_allclose(found.points_world_mm, triangulate(without, cameras).points_world_mm, rtol=0, atol=1e-5)


def test_four_of_sixteen_views_are_enough(make_rig: MakeRig) -> None:
    cameras, points = make_rig(16), _points(200)
    pixels = _observe(points, cameras, noise_px=0.5)
    is_outlier = _displace(pixels, share=1.0)
    found = triangulate(pixels, cameras)
    right = np.linalg.norm(found.points_world_mm - points, axis=1) < 5
    assert is_outlier.sum() == 200 * 12 and right.mean() > 0.97


def test_noise_gives_the_error_that_theory_gives(make_rig: MakeRig) -> None:
    cameras, points = make_rig(8, ("Pinhole",)), _points(2000)
    found = triangulate(_observe(points, cameras, noise_px=1.0), cameras)
    errors = found.points_world_mm - points
    # Cramér-Rao: covariance is the inverse of the sum over views of J^T J at 1 px
    step = 1e-3
    jacobian = np.stack(
        [
            [(camera.project(points + step * axis) - camera.project(points - step * axis)) / (2 * step)]
            for camera in cameras
            for axis in np.eye(3)
        ]
    ).reshape(8, 3, len(points), 2)
    information = np.einsum("vipk,vjpk->pij", jacobian, jacobian)
    expected = np.sqrt(np.trace(np.linalg.inv(information), axis1=1, axis2=2).mean())
    assert np.sqrt((errors**2).sum(axis=1).mean()) == pytest.approx(expected, rel=0.05)
    assert np.abs(errors.mean(axis=0)).max() < 0.05


def test_missing_views_are_no_matter_for_the_others(make_rig: MakeRig) -> None:
    cameras, points = make_rig(6), _points(4)
    pixels = _observe(points, cameras)
    pixels[0, 2:] = np.nan
    pixels[1, 1:] = np.nan
    pixels[2] = np.nan
    pixels[3, 4, 0] = np.nan
    for robust in (True, False):
        found = triangulate(pixels, cameras, robust=robust)
        assert found.status.tolist() == ["ok", "too_few_views", "too_few_views", "ok"]
        np.testing.assert_allclose(found.points_world_mm[[0, 3]], points[[0, 3]], rtol=0, atol=1e-6)
        assert np.isnan(found.points_world_mm[[1, 2]]).all()
        assert found.num_views.tolist() == [2, 0, 0, 5]
        assert np.isnan(found.reprojection_px[0, 2:]).all() and np.isfinite(found.reprojection_px[0, :2]).all()
    assert triangulate(pixels, cameras, min_views=3).status.tolist()[0] == "too_few_views"


def test_disagreeing_views_have_no_point(make_rig: MakeRig) -> None:
    cameras, points = make_rig(2), _points(20)
    pixels = _observe(points, cameras)
    # off the epipolar line: the two rays pass each other
    pixels[:, 0] += 60 * _across_epipolar_line(points, cameras)
    found = triangulate(pixels, cameras)
    assert set(found.status.tolist()) == {"high_reprojection"}
    assert np.isnan(found.points_world_mm).all() and not found.is_inlier.all(axis=1).any()
    plain = triangulate(pixels, cameras, robust=False)
    assert set(plain.status.tolist()) == {"high_reprojection"} and np.isfinite(plain.points_world_mm).all()


def _across_epipolar_line(points: np.ndarray, cameras: list[Camera]) -> np.ndarray:
    nearer = points + 0.01 * (cameras[1].center_world_mm - points)
    along = cameras[0].project(nearer) - cameras[0].project(points)
    return np.asarray(np.stack((-along[:, 1], along[:, 0]), axis=-1) / np.linalg.norm(along, axis=1, keepdims=True))


def test_rays_that_meet_behind_the_cameras() -> None:
    cameras = [_forward_camera(-100.0), _forward_camera(100.0)]
    pixels = np.array([[[270.0, 240.0], [370.0, 240.0]]])  # they diverge in front
    for robust in (True, False):
        found = triangulate(pixels, cameras, robust=robust)
        assert found.status.tolist() == ["behind_camera"] and not found.is_inlier.any()


def test_parallel_rays_are_degenerate() -> None:
    cameras = [_forward_camera(-1.0), _forward_camera(1.0)]
    pixels = np.array([[[320.5, 240.0], [319.5, 240.0]], [[345.0, 240.0], [295.0, 240.0]]])
    for robust in (True, False):
        found = triangulate(pixels, cameras, robust=robust)
        assert found.status.tolist() == ["degenerate", "ok"]
    twice = [_forward_camera(0.0), _forward_camera(0.0)]
    assert triangulate(np.array([[[330.0, 240.0], [330.0, 240.0]]]), twice).status.tolist() == ["degenerate"]


def test_a_view_in_front_of_which_the_point_is_not_is_no_inlier(make_rig: MakeRig) -> None:
    cameras, points = make_rig(4, ("Pinhole",)), _points(5)
    pixels = _observe(points, cameras)
    turned = transforms.rigid(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ cameras[3].T_camera_from_world
    cameras[3] = cameras[3].moved(turned)
    found = triangulate(pixels, cameras)
    assert (found.status == "ok").all()
    np.testing.assert_array_equal(found.is_inlier, np.tile([True, True, True, False], (5, 1)))
    assert np.isnan(found.reprojection_px[:, 3]).all()


def test_a_pixel_outside_the_field_is_not_used_but_has_a_residual(make_rig: MakeRig) -> None:
    from dataclasses import replace

    from assemblyhands_core.geometry.distortion import OpenCVLens

    cameras, points = make_rig(4), _points(3)
    cameras[0] = replace(cameras[0], lens=OpenCVLens(k1=-1 / 3))
    pixels = _observe(points, cameras)
    pixels[:, 0] = (950.0 + 1250.0, 545.0)
    found = triangulate(pixels, cameras)
    assert (found.status == "ok").all() and not found.is_inlier[:, 0].any() and found.is_inlier[:, 1:].all()
    expected = np.linalg.norm(cameras[0].project(points) - pixels[:, 0], axis=-1)
    np.testing.assert_allclose(found.reprojection_px[:, 0], expected, rtol=0, atol=1e-6)


def test_the_threshold_is_in_raw_pixels(make_rig: MakeRig) -> None:
    cameras, points = make_rig(12), _points(1)
    pixels = _observe(points, cameras)
    pixels[0, 5] += (5.0, 0.0)
    loose, tight = (triangulate(pixels, cameras, max_reprojection_px=limit) for limit in (6.0, 1.0))
    assert loose.is_inlier.all()
    assert tight.is_inlier.sum() == 11 and not tight.is_inlier[0, 5]
    assert tight.reprojection_px[0, 5] == pytest.approx(5.0, abs=1e-3)


def test_confidence_pulls_and_zero_confidence_removes(make_rig: MakeRig) -> None:
    cameras, points = make_rig(6), _points(50)
    pixels = _observe(points, cameras)
    pixels[:, 2] += 5.0
    even = np.ones((50, 6))
    distrust, ignore = even.copy(), even.copy()
    distrust[:, 2], ignore[:, 2] = 0.1, 0.0
    for robust in (True, False):
        errors = [
            np.linalg.norm(triangulate(pixels, cameras, weights, robust).points_world_mm - points, axis=1).mean()
            for weights in (even, distrust, ignore)
        ]
        assert errors[0] > 20 * errors[1] > 0 and errors[2] < 1e-6
        found = triangulate(pixels, cameras, ignore, robust)
        assert not found.is_inlier[:, 2].any() and (found.reprojection_px[:, 2] > 7).all()
    assert (triangulate(pixels[:, :2], cameras[:2], ignore[:, 1:3]).status == "too_few_views").all()


@pytest.mark.usefixtures("unchecked_types")
def test_bad_arguments_are_refused(make_rig: MakeRig) -> None:
    cameras = make_rig(3)
    pixels = _observe(_points(2), cameras)
    with pytest.raises(ValueError, match=r"Pixels have shape \(2, 3, 2\): expected \(points, 2 cameras, 2\)"):
        triangulate(pixels, cameras[:2])
    with pytest.raises(ValueError, match=r"Confidence has shape \(2, 2\)"):
        triangulate(pixels, cameras, np.ones((2, 2)))
    for wrong in (-1.0, np.nan):
        with pytest.raises(ValueError, match=f"Confidence of point 1 in view 2 is {wrong}"):
            triangulate(pixels, cameras, np.array([[1.0, 1.0, 1.0], [1.0, 1.0, wrong]]))
    with pytest.raises(ValueError, match="needs 2 views: got 1 cameras"):
        triangulate(pixels[:, :1], cameras[:1])
    pixels[1, 2] = np.nan  # without a pixel its confidence is not read
    assert triangulate(pixels, cameras, np.array([[1.0, 1.0, 1.0], [1.0, 1.0, np.nan]])).valid.all()


def test_no_points_are_no_problem(make_rig: MakeRig) -> None:
    for robust in (True, False):
        found = triangulate(np.empty((0, 4, 2)), make_rig(4), robust=robust)
        assert found.points_world_mm.shape == (0, 3) and found.status.shape == (0,)
        assert found.is_inlier.shape == found.reprojection_px.shape == (0, 4)


def test_points_do_not_know_their_block(make_rig: MakeRig) -> None:
    cameras, points = make_rig(4), _points(5000)
    pixels = _observe(points, cameras, noise_px=1.0)
    whole, last = triangulate(pixels, cameras), triangulate(pixels[-10:], cameras)
    np.testing.assert_allclose(whole.points_world_mm[-10:], last.points_world_mm, rtol=0, atol=1e-9)
    assert len(whole.status) == 5000


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), num_views=st.sampled_from([3, 5, 8, 12]))
def test_order_of_cameras_does_not_matter(make_rig: MakeRig, seed: int, num_views: int) -> None:
    cameras, points = make_rig(num_views, ALL_LENSES), _points(20, seed)
    pixels = _observe(points, cameras, noise_px=1.0, seed=seed)
    _displace(pixels, share=0.3, seed=seed)
    order = np.random.default_rng(seed).permutation(num_views)
    for robust in (True, False):
        plain = triangulate(pixels, cameras, robust=robust)
        mixed = triangulate(pixels[:, order], [cameras[view] for view in order], robust=robust)
        np.testing.assert_array_equal(mixed.status, plain.status)
        np.testing.assert_array_equal(mixed.is_inlier, plain.is_inlier[:, order])
        np.testing.assert_allclose(mixed.points_world_mm, plain.points_world_mm, rtol=0, atol=1e-5)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_a_rigid_change_of_world_moves_points_along(make_rig: MakeRig, seed: int) -> None:
    cameras, points = make_rig(8, ALL_LENSES), _points(20, seed)
    pixels = _observe(points, cameras, noise_px=1.0, seed=seed)
    _displace(pixels, share=0.3, seed=seed)
    generator = np.random.default_rng(seed)
    rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    new_from_old = transforms.rigid(rotation, generator.uniform(-2000, 2000, 3))
    moved = [camera.moved(camera.T_camera_from_world @ transforms.inverse(new_from_old)) for camera in cameras]
    old, new = triangulate(pixels, cameras), triangulate(pixels, moved)
    np.testing.assert_array_equal(new.status, old.status)
    np.testing.assert_array_equal(new.is_inlier, old.is_inlier)
    expected = transforms.apply(new_from_old, old.points_world_mm)
    np.testing.assert_allclose(new.points_world_mm, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(new.reprojection_px, old.reprojection_px, rtol=0, atol=1e-4)
