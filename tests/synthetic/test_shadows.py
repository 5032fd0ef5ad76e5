"""Shadows against the closed forms of points, spheres and discs."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scenes import OVERHEAD, PLAIN, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.render import BackgroundCache, Light, render


def _floor_light(light: Light, cached: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of light along z = 0 under a ball 300 mm above the floor, seen from the side, and x there."""
    camera = make_camera(size=(960, 720))
    static, moving = (make_floor(),), (make_sphere(1, (0.0, 300.0, 0.0), 60.0, subdivisions=5),)
    cache = BackgroundCache() if cached else None
    kinds = [make_scene(static, part, (light,)) for part in (moving, ())]
    shaded, free = (render(s, camera, sensor=PLAIN, frame_seed=0, background_cache=cache) for s in kinds)
    row = int(np.rint(camera.project(np.zeros(3))[1]))
    x = (np.arange(camera.width_px) - camera.cx_px) / camera.fx_px * 1000.0
    on_floor = shaded.object_id[row] == 100
    share = shaded.image[row, :, 0][on_floor] / free.image[row, :, 0][on_floor].astype(float)
    return x[on_floor], share


def _edges(light: Light, ball_mm: float, sign: int) -> tuple[float, float]:
    """Return where on the floor the two lines end that touch lamp and ball.

    They cross between them (sign 1: between them lies all that is not fully lit) or meet beyond the ball (sign -1:
    between them lies the full shadow).
    """
    lamp, ball, radius = np.array(light.position_mm[:2]), np.array([0.0, 300.0]), light.radius_mm
    between = ball - lamp
    crossing = lamp + between * radius / (radius + sign * ball_mm)
    middle = np.arctan2(between[0], -between[1])
    half = np.arcsin((ball_mm + sign * radius) / np.hypot(*between))
    left, right = (float(crossing[0] + crossing[1] * np.tan(middle + side * half)) for side in (-1, 1))
    return left, right


SIDE = replace(OVERHEAD, position_mm=(-1400.0, 2000.0, 0.0))  # throws the shadow beside what the ball itself hides


@pytest.mark.parametrize("cached", [False, True])
def test_the_shadow_of_a_ball_ends_where_the_touching_ray_meets_the_floor(cached: bool) -> None:
    left, right = _edges(SIDE, 60.0, 1)
    x, share = _floor_light(SIDE, cached)
    dark = x[share < 0.5]
    assert dark.min() == pytest.approx(left, abs=3.0) and dark.max() == pytest.approx(right, abs=3.0)
    assert share[(x > left + 6) & (x < right - 6)].max() == 0.0
    assert share[(x < left - 6) | (x > right + 6)].min() > 0.98


@pytest.mark.parametrize("cached", [False, True])
def test_a_large_lamp_gives_soft_edges_of_the_right_width(cached: bool) -> None:
    light = replace(SIDE, radius_mm=150.0)
    (outer_left, outer_right), (inner_left, inner_right) = _edges(light, 60.0, 1), _edges(light, 60.0, -1)
    assert outer_right - inner_right > 25 and inner_right - inner_left > 25
    x, share = _floor_light(light, cached)
    assert share[(x > inner_left + 8) & (x < inner_right - 8)].max() < 0.03
    assert share[(x < outer_left - 8) | (x > outer_right + 8)].min() > 0.97
    for inner, outer in [(inner_left, outer_left), (inner_right, outer_right)]:
        assert 0.2 < share[np.abs(x - (inner + outer) / 2).argmin()] < 0.8


def test_a_lamp_may_cast_no_shadow() -> None:
    _, share = _floor_light(replace(SIDE, casts_shadow=False), False)
    assert share.min() == 1.0


def test_static_and_moving_bodies_shade_one_another() -> None:
    camera, light = make_camera(size=(480, 360)), replace(OVERHEAD, position_mm=(-700.0, 2000.0, 0.0))
    above, below = make_sphere(1, (0.0, 300.0, 0.0), 60.0), make_sphere(2, (90.0, 80.0, 0.0), 40.0)
    floor = make_floor()
    images = []
    for static, moving in [((floor, above, below), ()), ((floor, above), (below,)), ((floor, below), (above,))]:
        cache = BackgroundCache()
        scene = make_scene(static, moving, (light,))
        images.append(render(scene, camera, sensor=PLAIN, frame_seed=0, background_cache=cache).image.astype(int))
    at = np.rint(camera.project(np.array([90.0, 120.0, 0.0]))).astype(int)
    assert images[0][at[1], at[0], 0] == 0  # the upper ball keeps the light from the top of the lower one
    for image in images[1:]:
        assert (np.abs(image - images[0]).max(axis=-1) > 10).mean() < 0.002
