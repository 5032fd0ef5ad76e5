"""Brightness of surfaces, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scenes import OVERHEAD, make_camera, make_floor, make_scene

from assemblyhands_core.synthetic.bodies import Body, Light, merged
from assemblyhands_core.synthetic.lens_rays import LensRays
from assemblyhands_core.synthetic.shading import WHITE, collect, pixel_rad, shade

CAMERA = make_camera(size=(101, 101))


def _terms(body: Body, lights: tuple[Light, ...], pixel: int, ambient: float = 0.0) -> np.ndarray:
    scene = replace(make_scene((body,), (), lights), ambient=(ambient,) * 3)
    rays = LensRays.of(CAMERA).world(CAMERA, np.array([pixel], np.int32))
    surfaces = merged(scene.static)
    hits = surfaces.first_hits(CAMERA.center_world_mm.astype(np.float32), rays)
    return shade(scene, surfaces, CAMERA, rays, hits).terms[0]


def test_a_matt_floor_follows_lambert_and_the_inverse_square() -> None:
    floor = make_floor(albedo=0.5)
    lights = OVERHEAD, Light((1500.0, 2000.0, 0.0), 0.0, (1.0, 2.0, 3.0))
    pixel = 50 * 101 + 50
    terms = _terms(floor, lights, pixel)
    distance_m, cosine = 2.5, 0.8
    np.testing.assert_allclose(terms[0], 0.0)
    np.testing.assert_allclose(terms[1], 0.5 * 2.0 / 4.0, rtol=2e-3)
    np.testing.assert_allclose(terms[2], 0.5 * np.array([1.0, 2.0, 3.0]) * cosine / distance_m**2, rtol=4e-3)


def test_lamps_behind_a_surface_do_not_light_it() -> None:
    assert not _terms(make_floor(), (Light((0.0, -500.0, 0.0)),), 0)[1].any()


def test_light_from_everywhere_is_stronger_on_the_side_of_the_lamps() -> None:
    above = _terms(make_floor(), (OVERHEAD,), 5100, ambient=0.4)[0, 0]
    below = _terms(make_floor(), (Light((0.0, -2000.0, 0.0)),), 5100, ambient=0.4)[0, 0]
    assert above == pytest.approx(0.5 * 0.4, rel=0.02) and 0.35 < below / above < 0.6


def test_gloss_makes_a_highlight_where_the_lamp_is_mirrored() -> None:
    matt, glossy = make_floor(), replace(make_floor(), gloss=0.8)
    mirrored, aside = 50 * 101 + 50, 50 * 101 + 20
    gain = [_terms(glossy, (OVERHEAD,), p)[1, 0] - _terms(matt, (OVERHEAD,), p)[1, 0] for p in (mirrored, aside)]
    assert gain[0] > 0.3 and gain[1] < 0.1 * gain[0]


def test_metal_has_coloured_highlights_and_no_diffuse_part() -> None:
    gold = np.tile(np.array([0.8, 0.6, 0.2], np.float32), (8, 1))
    metal = replace(make_floor(), albedo=gold, gloss=0.8, metallic=1.0)
    mirrored, aside = (_terms(metal, (OVERHEAD,), p)[1] for p in (50 * 101 + 50, 50 * 101))
    np.testing.assert_allclose(mirrored / mirrored[0], [1.0, 0.75, 0.25], rtol=1e-3)
    assert aside.max() < 0.05 * mirrored.max()


def test_light_is_added_up_with_its_shares() -> None:
    terms = np.array([[[0.1, 0.2, 0.3], [0.4, 0.4, 0.4], [5.0, 5.0, 5.0]]], dtype=np.float32)
    linear, direct = np.zeros((2, 3, 3), np.uint16), np.zeros((2, 2, 3, 3), np.uint16)
    collect(np.array([4], np.int32), terms, np.array([[0.5], [0.0]], np.float32), linear, direct)
    np.testing.assert_allclose(linear[1, 1] / WHITE, [0.3, 0.4, 0.5], atol=1e-4)
    np.testing.assert_allclose(direct[:, 1, 1] / WHITE, [[0.2] * 3, [0.0] * 3], atol=1e-4)
    assert np.count_nonzero(linear) == 3
    collect(np.array([4], np.int32), terms, np.ones((2, 1), np.float32), linear, direct[:0])
    assert linear[1, 1].tolist() == [65535] * 3  # saturated, not wrapped


def test_the_angle_of_a_pixel() -> None:
    assert pixel_rad(CAMERA) == pytest.approx(1 / CAMERA.fx_px)
