"""The rays of pixels against the exact inverse of the lens."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scenes import make_camera

from assemblyhands_core.geometry.distortion import OVFishEye62
from assemblyhands_core.synthetic.lens_rays import MAX_RESIDUAL_PX, LensRays


@pytest.mark.parametrize("model", ["Pinhole", "OpenCV", "OVFishEye62"])
def test_rays_are_those_of_the_lens(model: str) -> None:
    camera = make_camera(model, size=(637, 481))
    pixels = np.random.default_rng(0).integers(0, 637 * 481, 5000).astype(np.int32)
    rays = LensRays.of(camera).world(camera, pixels)
    exact = camera.unproject(np.stack((pixels % 637, pixels // 637), axis=-1).astype(float))
    assert np.linalg.norm(rays - exact, axis=-1).max() * camera.fx_px < MAX_RESIDUAL_PX * 1.1
    back = camera.project(camera.center_world_mm + 1000.0 * rays.astype(float))
    assert np.abs(back - np.stack((pixels % 637, pixels // 637), axis=-1)).max() < 0.01


def test_a_lens_is_worked_out_once_whatever_the_pose() -> None:
    camera = make_camera("OVFishEye62")
    moved = camera.moved(make_camera("OVFishEye62", 1300.0).T_camera_from_world)
    assert LensRays.of(camera) is LensRays.of(moved)
    assert LensRays.of(camera) is not LensRays.of(replace(camera, cx_px=camera.cx_px + 1))


def test_there_are_no_rays_outside_the_field() -> None:
    camera = replace(make_camera("OVFishEye62", size=(636, 480)), lens=OVFishEye62(k1=-0.2))
    rows, columns = np.indices((480, 636))
    exact = np.isnan(camera.unproject(np.stack((columns, rows), axis=-1).astype(float))[..., 0])
    found = np.isnan(LensRays.of(camera).rays[..., 0])
    assert found[exact].all() and (found & ~exact).mean() < 0.01 and 0.3 < found.mean() < 0.8
