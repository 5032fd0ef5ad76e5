"""Meshes that rays are cast at: normals, hits and what lies there."""

import numpy as np
import trimesh
from drawn_scenes import make_body, make_sphere

from assemblyhands_core.synthetic.bodies import merged
from assemblyhands_core.synthetic.surfaces import FAR_MM, MISS

ORIGIN = np.zeros(3, np.float32)


def test_round_bodies_are_smooth_and_edges_of_boxes_sharp() -> None:
    ball = make_sphere(1, (0, 0, 0), 100.0)
    round_ = merged([ball])
    np.testing.assert_allclose(round_.corner_normals, (ball.vertices_mm / 100.0)[ball.faces], atol=0.01)
    sharp = merged([make_body(trimesh.creation.box((2, 2, 2)), 1)])
    np.testing.assert_allclose(np.abs(sharp.corner_normals).max(axis=-1), 1.0, atol=1e-6)


def test_the_rim_of_a_cylinder_is_sharp_and_its_side_smooth() -> None:
    cylinder = trimesh.creation.cylinder(10.0, 50.0, sections=24)
    normals = merged([make_body(cylinder, 1)]).corner_normals
    is_cap = np.abs(cylinder.face_normals[:, 2]) > 0.5
    np.testing.assert_allclose(np.abs(normals[is_cap][..., 2]), 1.0, atol=1e-5)
    np.testing.assert_allclose(normals[~is_cap][..., 2], 0.0, atol=1e-5)
    radial = cylinder.vertices[cylinder.faces[~is_cap]][..., :2] / 10.0
    np.testing.assert_allclose(normals[~is_cap][..., :2], radial, atol=0.1)


def test_a_hit_by_hand() -> None:
    vertices = np.array([[-1, -1, 5], [3, -1, 5], [-1, 3, 5]], dtype=np.float32)
    triangle = trimesh.Trimesh(vertices, [[0, 2, 1]], process=False)
    surfaces = merged([make_body(triangle, 9, albedo=0.25)])
    rays = np.array([[0, 0, 1], [0, 0, -1], [np.nan] * 3], dtype=np.float32)
    hits = surfaces.first_hits(ORIGIN, rays)
    assert hits.faces.tolist() == [0, MISS, MISS] and hits.distances_mm.tolist() == [5.0, FAR_MM, FAR_MM]
    np.testing.assert_allclose(hits.weights[0], [0.25, 0.25], atol=1e-6)
    points = surfaces.points(ORIGIN, rays[:1], hits.select(np.array([0])))
    np.testing.assert_allclose(points.normals, [[0, 0, -1]], atol=1e-6)
    np.testing.assert_allclose(points.positions_mm, [[0, 0, 4.95]], atol=1e-5)
    np.testing.assert_allclose(points.places_mm, [[0, 0, 5]], atol=1e-6)
    assert points.albedo.tolist() == [[0.25] * 3] and surfaces.ids(hits.faces[:1]).tolist() == [9]


def test_segments_are_blocked_between_their_ends_only() -> None:
    surfaces = merged([make_sphere(1, (0, 0, 100), 10.0)])
    starts = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 200]], dtype=np.float32)
    extents = np.array([[0, 0, 95], [0, 0, 85], [0, 50, 95], [0, 0, -95]], dtype=np.float32)
    assert surfaces.blocked(starts, extents).tolist() == [True, False, False, True]


def test_no_bodies_at_all() -> None:
    empty = merged([])
    assert empty.first_hits(ORIGIN, np.array([[0, 0, 1]], np.float32)).faces.tolist() == [MISS]
    assert not empty.blocked(np.zeros((2, 3), np.float32), np.ones((2, 3), np.float32)).any()
