"""The linear triangulation."""

from collections.abc import Callable

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.dlt import linear_points
from assemblyhands_core.geometry.sightlines import sightlines


@pytest.mark.parametrize("weighted", [False, True])
def test_it_is_the_least_squares_solution_of_the_textbook_rows(
    make_rig: Callable[..., list[Camera]], weighted: bool
) -> None:
    cameras = make_rig(5, ("Pinhole",))
    generator = np.random.default_rng(0)
    points = generator.uniform(-100, 100, (4, 3))
    confidence = generator.uniform(0.1, 1.0, (4, 5))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1) + generator.normal(0, 3, (4, 5, 2))
    found = linear_points(sightlines(pixels, cameras, confidence), cameras, weighted)
    for point in range(4):
        rows = []
        for view, camera in enumerate(cameras):
            x, y = pixels[point, view]
            if weighted:  # pixel rows u P3 - P1 of P = K [R | t]
                p, weight = camera.P_pixel_from_world, confidence[point, view]
            else:  # normalised rows of [R | t]
                p, weight = camera.T_camera_from_world[:3], 1.0
                x, y = (x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px
            rows += [weight * (x * p[2] - p[0]), weight * (y * p[2] - p[1])]
        homogeneous = np.linalg.svd(np.array(rows))[2][-1]
        np.testing.assert_allclose(found[point], homogeneous[:3] / homogeneous[3], rtol=0, atol=1e-7)


def test_fisheye_rays_beyond_90_degrees_take_part(make_rig: Callable[..., list[Camera]]) -> None:
    cameras = make_rig(4, ("OVFishEye62",))
    side = cameras[0].center_world_mm + cameras[0].T_camera_from_world[:3, :3].T @ np.array([300.0, 50.0, -60.0])
    pixels = np.stack([camera.project(side[None]) for camera in cameras], axis=1)
    assert cameras[0].depth_mm(side) < 0
    lines = sightlines(pixels, cameras, np.ones((1, 4)))
    assert lines.usable[0, 0] and lines.usable.sum() >= 2
    np.testing.assert_allclose(linear_points(lines, cameras, False), side[None], rtol=0, atol=1e-7)
