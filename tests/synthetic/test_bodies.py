"""Bodies and how they are merged."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_scenes import make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.bodies import merged
from assemblyhands_core.synthetic.materials import Texture


def test_bodies_keep_their_own_vertices_and_materials() -> None:
    texture = Texture("wood", (0.1, 0.2, 0.3), 5.0, 0.5)
    ball = replace(make_sphere(3, (10, 0, 0), 4.0), gloss=0.7, metallic=1.0, texture=texture)
    rest = replace(ball, object_id=4, rest_mm=ball.vertices_mm - np.float32(10.0))
    mesh = merged([make_floor(), ball, rest])
    counts = [8, len(ball.vertices_mm), len(ball.vertices_mm)]
    assert np.bincount(mesh.body_of_face).tolist() == [12, len(ball.faces), len(ball.faces)]
    for index, start in enumerate(np.cumsum([0, *counts[:-1]])):
        used = mesh.faces[mesh.body_of_face == index]
        assert used.min() == start and used.max() == start + counts[index] - 1
    assert mesh.object_ids.tolist() == [100, 3, 4] and mesh.metallic.tolist() == [0.0, 1.0, 1.0]
    np.testing.assert_array_equal(mesh.rest_mm[8 : 8 + counts[1]], ball.vertices_mm)
    np.testing.assert_array_equal(mesh.rest_mm[8 + counts[1] :], rest.rest_mm)
    np.testing.assert_allclose(mesh.textures[1, 1:6], [5.0, 0.5, 0.1, 0.2, 0.3], rtol=1e-6)
    assert not mesh.textures[0].any()


def test_wrong_bodies_are_refused() -> None:
    ball = make_sphere(3, (0, 0, 0), 4.0, subdivisions=1)
    with pytest.raises(ValueError, match="has object id 256; an id mask holds 1 to 255 only"):
        replace(ball, object_id=256)
    with pytest.raises(ValueError, match="a face names a vertex beyond its 5 vertices"):
        replace(ball, vertices_mm=ball.vertices_mm[:5], albedo=ball.albedo[:5])


def test_meshes_are_made_once_per_scene() -> None:
    scene = make_scene((make_floor(),), (make_sphere(1, (0, 50, 0), 20.0),))
    assert scene.moving_surfaces is scene.moving_surfaces and len(scene.shadow_maps) == 1
