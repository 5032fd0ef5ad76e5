"""Refinement: where it ends is the minimum of the robust cost, found independently."""

from collections.abc import Callable

import numpy as np

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.refinement import depth_along_rays_mm, gauss_newton_step, refine
from assemblyhands_core.geometry.sightlines import sightlines


def _cost(point: np.ndarray, pixels: np.ndarray, cameras: list[Camera], threshold: float) -> float:
    """Return the sum over views of Geman & McClure's s / (1 + s), whose weight is 1 / (1 + s)²."""
    errors = [camera.project(point) - pixel for camera, pixel in zip(cameras, pixels, strict=True)]
    squared = (np.array(errors) ** 2).sum(axis=-1) / threshold**2
    return float((squared / (1 + squared)).sum())


def test_it_ends_at_the_minimum_of_the_robust_cost(make_rig: Callable[..., list[Camera]]) -> None:
    cameras = make_rig(6, ("Pinhole",))
    generator = np.random.default_rng(0)
    points = generator.uniform(-100, 100, (5, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1) + generator.normal(0, 2, (5, 6, 2))
    lines = sightlines(pixels, cameras, np.ones((5, 6)))
    refined = refine(lines, points, 10.0)
    assert 0.2 < np.linalg.norm(refined - points, axis=1).max() < 5
    for point, observed in zip(refined, pixels, strict=True):
        least = _cost(point, observed, cameras, 10.0)
        for step in 0.02 * np.vstack((np.eye(3), -np.eye(3))):
            assert _cost(point + step, observed, cameras, 10.0) > least


def test_a_refined_point_stays(make_rig: Callable[..., list[Camera]]) -> None:
    cameras = make_rig(5)
    points = np.random.default_rng(0).uniform(-100, 100, (5, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1) + 1.0
    lines = sightlines(pixels, cameras, np.ones((5, 5)))
    refined = refine(lines, points, 10.0)
    np.testing.assert_allclose(gauss_newton_step(lines, refined, 10.0), refined, rtol=0, atol=1e-7)


def test_lost_points_stay_lost_and_lonely_ones_do_not_move(make_rig: Callable[..., list[Camera]]) -> None:
    cameras = make_rig(3)
    points = np.array([[np.nan] * 3, [1.0, 2.0, 3.0]])
    pixels = np.full((2, 3, 2), np.nan)
    pixels[1, 0] = (900.0, 500.0)
    refined = refine(sightlines(pixels, cameras, np.ones((2, 3))), points, 10.0)
    assert np.isnan(refined[0]).all()
    np.testing.assert_array_equal(refined[1], points[1])


def test_depth_is_measured_along_the_ray(make_rig: Callable[..., list[Camera]]) -> None:
    cameras = make_rig(3)
    origin = np.zeros((1, 3))
    pixels = np.stack([camera.project(origin) for camera in cameras], axis=1)
    depth = depth_along_rays_mm(sightlines(pixels, cameras, np.ones((1, 3))), origin)
    np.testing.assert_allclose(depth, [[900.0, 940.0, 980.0]], rtol=0, atol=1e-9)
