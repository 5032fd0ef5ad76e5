"""Tiles that shadows may reach: all that they do reach, and not many more."""

import numpy as np
import pytest
from drawn_scenes import OVERHEAD, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.bodies import Light, merged
from assemblyhands_core.synthetic.coverage import TILE_PX, LightMap, num_tiles
from assemblyhands_core.synthetic.views import static_view

LIGHTS = OVERHEAD, Light((-900.0, 1500.0, 300.0), 200.0), Light((0.0, 2000.0, -1500.0), 100.0)


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("place", [(0.0, 200.0, 0.0), (250.0, 60.0, -100.0)])
def test_all_shaded_pixels_lie_in_the_tiles(index: int, place: tuple[float, float, float]) -> None:
    camera, light = make_camera(size=(480, 360)), LIGHTS[index]
    scene = make_scene((make_floor(),), (make_sphere(1, place, 50.0),), (light,))
    view = static_view(scene, merged(scene.static), camera)
    tiles = view.shadow_tiles(scene, 0)
    assert tiles.shape == num_tiles(360, 480) == (45, 60)
    every = np.arange(480 * 360, dtype=np.int32)
    positions = view.positions_mm(every)
    shaded = np.zeros(len(every), bool)
    for direction in np.random.default_rng(0).normal(size=(40, 3)):
        point = np.array(light.position_mm) + light.radius_mm * direction / np.linalg.norm(direction)
        shaded |= scene.moving_surfaces.blocked(positions, (point - positions).astype(np.float32))
    in_tiles = tiles.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)[:360, :480]
    assert shaded.sum() > 300 and in_tiles.ravel()[shaded].all()
    assert in_tiles.sum() < 8 * shaded.sum() + 4000


def test_directions_are_equidistant_around_the_axis() -> None:
    around = LightMap.towards((10.0, 20.0, 30.0), 0.0, np.array([10.0, 20.0, 130.0]))
    points = np.array([[10, 20, 80], [60, 20, 80], [60, 20, 30], [110, 20, -70]], dtype=np.float32)
    cells, distances = around.cells(points)
    angles = np.linalg.norm(cells - 256.0, axis=-1) * 180 / 256
    np.testing.assert_allclose(angles, [0.0, 45.0, 90.0, 135.0], atol=1e-3)
    np.testing.assert_allclose(distances, [50, 50 * np.sqrt(2), 50, 100 * np.sqrt(2)], rtol=1e-6)


def test_no_moving_bodies_no_shadows() -> None:
    scene = make_scene((make_floor(),), (), LIGHTS)
    view = static_view(scene, merged(scene.static), make_camera())
    assert not any(view.shadow_tiles(scene, light).any() for light in range(3))
