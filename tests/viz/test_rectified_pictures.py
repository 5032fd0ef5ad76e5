import cv2
import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.geometry.distortion import lens_from_coefficients
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.viz.rectified_pictures import PictureRectifier, reduced_size_px

LENS = lens_from_coefficients("OpenCV", {"k1": -0.2, "k2": 0.05, "p1": 0.002, "p2": -0.001})
RAW = Camera("front", 320, 240, 260.0, 262.0, 158.0, 121.0, LENS, np.eye(4))
POINTS_MM = np.array([[-300.0, -200, 1000], [350, 100, 1000], [-100, 250, 1000], [40, -30, 1000]])


def _spots(camera: Camera, points: np.ndarray) -> np.ndarray:
    """A dark picture of a camera with a soft spot at each point."""
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    picture = np.full(x.shape, 10.0)
    for u, v in camera.project(points):
        picture += 230 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 3.0**2))
    return np.repeat(picture.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _spot_near(picture: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Return the centre of the light within a few pixels."""
    x, y = np.meshgrid(np.arange(picture.shape[1]), np.arange(picture.shape[0]))
    weight = (picture[..., 0].astype(float) - 10).clip(0) * (np.hypot(x - pixel[0], y - pixel[1]) < 8)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize("max_side_px", [1000, 160])
@pytest.mark.parametrize("is_reduced_before", [False, True])
def test_what_is_seen_is_where_the_camera_projects_it(max_side_px: int, is_reduced_before: bool) -> None:
    target = rectified(RAW)
    rectify = PictureRectifier(target, RemapGrid.build(RAW, target), max_side_px)
    raw = _spots(RAW, POINTS_MM)
    size_px = (rectify.camera.width_px, rectify.camera.height_px)
    if is_reduced_before:
        raw = np.asarray(cv2.resize(raw, size_px, interpolation=cv2.INTER_AREA))
    picture = rectify(raw)
    assert picture.shape == (size_px[1], size_px[0], 3) and max(size_px) == min(max_side_px, 320)
    for pixel in rectify.camera.project(POINTS_MM):
        np.testing.assert_allclose(_spot_near(picture, pixel), pixel, atol=0.25)


def test_sizes_keep_their_shape_and_never_grow() -> None:
    assert reduced_size_px(1920, 1080, 960) == (960, 540)
    assert reduced_size_px(1088, 1920, 960) == (544, 960)
    assert reduced_size_px(636, 480, 960) == (636, 480)
    assert reduced_size_px(3000, 1, 100) == (100, 1)
