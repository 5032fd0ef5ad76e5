"""A small rig of made-up cameras, one ring around the origin, with any lens."""

from collections.abc import Callable

import numpy as np
import pytest

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Lens, OpenCVLens, OVFishEye62, Pinhole

LENSES: dict[str, Lens] = {
    "Pinhole": Pinhole(),
    "OpenCV": OpenCVLens(k1=-0.13, k2=0.12, k3=-0.02, p1=-6e-4, p2=7e-4),
    "OVFishEye62": OVFishEye62(k1=0.27, k2=0.1, k3=-0.33, k4=0.26, k5=-0.1, k6=0.015, p1=1.1e-3, p2=-7e-4),
}


def _look_at_origin(center_mm: np.ndarray, roll_rad: float = 0.0) -> np.ndarray:
    """Return `T_camera_from_world` of a camera at `center_mm` whose axis passes through the origin."""
    forward = -center_mm / np.linalg.norm(center_mm)
    right = np.cross([0.3, 1.0, 0.2], forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    turned = np.cos(roll_rad) * right + np.sin(roll_rad) * down
    rotation = np.stack((turned, np.cross(forward, turned), forward))
    return transforms.rigid(rotation, -rotation @ center_mm)


def _make_camera(model: str, center_mm: np.ndarray, camera_id: str = "a", roll_rad: float = 0.0) -> Camera:
    """Return a 1920×1080 (perspective) or 636×480 (fisheye) camera that looks at the origin."""
    pose = _look_at_origin(center_mm, roll_rad)
    if model == "OVFishEye62":
        return Camera(camera_id, 636, 480, 190.0, 191.0, 320.5, 238.0, LENSES[model], pose)
    return Camera(camera_id, 1920, 1080, 1250.0, 1240.0, 950.0, 545.0, LENSES[model], pose)


@pytest.fixture(scope="session")
def make_camera() -> Callable[..., Camera]:
    """Return a maker of single cameras."""
    return _make_camera


@pytest.fixture(scope="session")
def make_rig() -> Callable[..., list[Camera]]:
    """Return a maker of rigs: cameras about 1 m from the origin, spread over a hemisphere, lenses in turn."""

    def make(num_views: int, models: tuple[str, ...] = ("OpenCV",)) -> list[Camera]:
        cameras = []
        for view in range(num_views):
            azimuth, height = 2.4 * view, 0.3 + 0.5 * (view % 3)
            direction = np.array([np.cos(azimuth), height, np.sin(azimuth)])
            center = direction / np.linalg.norm(direction) * (900 + 40 * view)
            cameras.append(_make_camera(models[view % len(models)], center, f"c{view}", roll_rad=0.3 * view))
        return cameras

    return make
