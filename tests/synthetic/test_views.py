"""Views: what they note of what they see, and the memory that pictures take."""

import sys
from pathlib import Path

import numpy as np
import pytest
from drawn_scenes import PLAIN, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.render import BackgroundCache, render
from assemblyhands_core.synthetic.surfaces import FAR_MM
from assemblyhands_core.synthetic.views import complete_view, static_view


def test_a_view_notes_distances_ids_and_places() -> None:
    camera = make_camera()
    scene = make_scene((make_floor(size_mm=400.0),), (make_sphere(1, (0.0, 300.0, 0.0), 50.0),))
    view = complete_view(scene, scene.static_surfaces, camera)
    x, y = np.rint(camera.project(np.array([[0.0, 350.0, 0.0], [150.0, 0.0, 150.0]]))).astype(int).T
    assert view.ids[y, x].tolist() == [1, 100] and view.ids[0, 0] == 0 and view.distances_mm[0, 0] == FAR_MM
    np.testing.assert_allclose(view.distances_mm[y, x], [650.0, np.hypot(1000.0, 150.0 * np.sqrt(2))], rtol=2e-3)
    positions = view.positions_mm((y * 320 + x).astype(np.int32))
    np.testing.assert_allclose(positions, [[0.0, 350.0, 0.0], [150.0, 0.0, 150.0]], atol=3.0)
    assert view.linear[0, 0].tolist() == [0, 0, 0] and view.linear[y, x].min() > 0


def test_a_copy_leaves_the_view_alone() -> None:
    scene = make_scene((make_floor(),))
    view = static_view(scene, scene.static_surfaces, make_camera())
    copy = view.copy()
    copy.linear[:], copy.ids[:], copy.distances_mm[:] = 0, 7, 1.0
    assert view.linear.max() > 0 and (view.ids == 100).all() and view.distances_mm.min() > 900


@pytest.mark.skipif(sys.platform != "linux", reason="reads the memory of the process from /proc")
def test_pictures_of_many_instants_take_no_more_memory() -> None:
    camera, cache, floor = make_camera(), BackgroundCache(), make_floor()

    def take(count: int) -> int:
        for x in range(count):
            scene = make_scene((floor,), (make_sphere(1, (float(x), 200.0, 0.0), 50.0),))
            render(scene, camera, sensor=PLAIN, frame_seed=x, background_cache=cache)
            render(scene, camera, sensor=PLAIN, frame_seed=x, background_cache=cache, is_fixed=False)
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096

    before = take(10)
    assert take(30) - before < 8e6
