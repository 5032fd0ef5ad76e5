import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.geometry.transforms import rigid
from assemblyhands_core.viz.first_look import look_at_hands, up_axis

CAMERA = Camera("front", 640, 480, 500.0, 510.0, 320.0, 240.0, Pinhole(), rigid(np.eye(3), np.array([0, 0, 900.0])))
HAND = np.stack([np.arange(21.0), 10 * np.arange(21.0), np.full(21, 5.0)], axis=1)


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_up_is_where_upright_cameras_have_it(up: str) -> None:
    axis = np.eye(3)["xyz".index(up[1])] * (1 if up[0] == "+" else -1)
    forward = np.roll(axis, 1)
    rotation = np.stack([np.cross(-axis, forward), -axis, forward])  # camera y points down
    tilted = np.array([[1, 0, 0], [0, np.cos(0.4), -np.sin(0.4)], [0, np.sin(0.4), np.cos(0.4)]]) @ rotation
    cameras = [CAMERA.moved(rigid(R, np.zeros(3))) for R in (rotation, tilted)]
    assert np.linalg.det(rotation) == pytest.approx(1) and up_axis(cameras) == up
    assert up_axis([]) == "+z"


def test_one_looks_at_the_hands_from_the_cameras_side() -> None:
    look = look_at_hands(HAND, [CAMERA], "-y")
    assert look is not None
    np.testing.assert_allclose(look.target_world_mm, [10.0, 100.0, 5.0])
    side = CAMERA.center_world_mm - look.target_world_mm
    eye = look.eye_world_mm - look.target_world_mm
    np.testing.assert_allclose(eye / np.linalg.norm(eye), side / np.linalg.norm(side))
    np.testing.assert_allclose([np.linalg.norm(eye), *look.up_world], [500.0, 0, -1, 0])
    assert look_at_hands(np.full((4, 3), np.nan), [CAMERA], "+z") is None is look_at_hands(HAND, [], "+z")
