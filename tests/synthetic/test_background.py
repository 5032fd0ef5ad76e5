"""What is kept of static bodies, and for how long."""

from dataclasses import replace

import pytest
from drawn_scenes import OVERHEAD, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.background import BackgroundCache


def test_views_are_kept_until_the_camera_moves() -> None:
    cache, floor = BackgroundCache(), make_floor()
    scene, camera = make_scene((floor,)), make_camera()
    view = cache.view(scene, camera)
    assert cache.view(make_scene((floor,), (make_sphere(1, (0, 50, 0), 20.0),)), camera) is view
    moved = cache.view(scene, make_camera(height_mm=1100.0))
    assert moved is not view and cache.num_views == 1  # the memory taken does not grow as a camera moves
    assert cache.view(scene, replace(camera, cx_px=10.0)) is not moved
    assert cache.view(scene, replace(camera, camera_id="other")) is not view and cache.num_views == 2


def test_the_mesh_is_made_once() -> None:
    cache, floor = BackgroundCache(), make_floor()
    assert cache.surfaces(make_scene((floor,))) is cache.surfaces(make_scene((floor,)))


@pytest.mark.parametrize("change", ["static", "lights", "ambient", "backdrop"])
def test_anything_else_is_refused(change: str) -> None:
    cache, scene = BackgroundCache(), make_scene((make_floor(),))
    cache.surfaces(scene)
    other = {
        "static": (make_floor(),),
        "lights": (replace(OVERHEAD, radius_mm=5.0),),
        "ambient": (0.1, 0.1, 0.1),
        "backdrop": (0.1, 0.1, 0.1),
    }
    with pytest.raises(ValueError, match="The static bodies or lights of this scene are not those"):
        cache.surfaces(replace(scene, **{change: other[change]}))
