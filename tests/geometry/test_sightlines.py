"""Sight lines: rays, and pixel errors that they predict for points beside them."""

from collections.abc import Callable

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.sightlines import sightlines, tangents


@pytest.mark.parametrize("model", ["Pinhole", "OpenCV", "OVFishEye62"])
def test_rows_predict_pixel_errors_to_second_order(make_rig: Callable[..., list[Camera]], model: str) -> None:
    cameras = make_rig(4, (model,))
    points = np.random.default_rng(0).uniform(-150, 150, (30, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1)
    lines = sightlines(pixels, cameras, np.ones((30, 4)))
    for size_mm, allowed_px in ((1.0, 0.01), (0.1, 1e-4)):  # a hundredth for a tenth
        near = points + size_mm * np.array([0.6, 0.64, 0.48])
        offset = near[:, None] - lines.centers_mm
        predicted = np.einsum("pvij,pvj->pvi", lines.rows, offset) / (lines.rays * offset).sum(-1)[..., None]
        actual = np.stack([camera.project(near) for camera in cameras], axis=1) - pixels
        assert np.abs(predicted - actual).max() < allowed_px
        assert np.abs(actual).max() > 0.1 * size_mm


def test_unusable_views_are_zero_not_nan(make_rig: Callable[..., list[Camera]]) -> None:
    pixels = np.full((1, 3, 2), 500.0)
    pixels[0, 1] = np.nan
    lines = sightlines(pixels, make_rig(3), np.array([[2.0, 1.0, 0.0]]))
    assert lines.usable.tolist() == [[True, False, False]] and lines.confidence.tolist() == [[2.0, 0.0, 0.0]]
    assert not lines.rays[0, 1:].any() and not lines.rows[0, 1:].any()
    np.testing.assert_allclose(np.linalg.norm(lines.rays[0, 0]), 1.0, rtol=0, atol=1e-14)


def test_tangents_complete_an_orthonormal_frame() -> None:
    rays = np.random.default_rng(0).normal(size=(100, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    frames = np.stack((*tangents(rays), rays), axis=1)
    np.testing.assert_allclose(frames @ frames.swapaxes(1, 2), np.tile(np.eye(3), (100, 1, 1)), rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, rtol=0, atol=1e-10)
