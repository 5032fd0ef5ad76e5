"""Faces found by their image against faces found by Embree."""

import numpy as np
import pytest
import trimesh
from drawn_scenes import make_body, make_camera, make_floor

from assemblyhands_core.synthetic.bodies import merged
from assemblyhands_core.synthetic.casting import cast_all, cast_at
from assemblyhands_core.synthetic.lens_rays import LensRays
from assemblyhands_core.synthetic.surfaces import FAR_MM, MISS


def _pieces(seed: int, around_camera: bool) -> list:
    """Return boxes and balls of all sizes, in front of the camera or also around it."""
    generator = np.random.default_rng(seed)
    lowest = 200.0 if around_camera else -600.0
    bodies = []
    for index in range(14):
        size = generator.uniform(10, 260)
        mesh = (
            trimesh.creation.box((size, 0.6 * size, 1.7 * size))
            if index % 2
            else trimesh.creation.icosphere(2, size / 2)
        )
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(generator.random(3)))
        place = generator.uniform((-900, lowest, -700), (900, lowest + 1000, 700))
        if np.linalg.norm(place - [0, 1000, 0]) > 300:
            bodies.append(make_body(mesh, index + 1, tuple(place)))
    return bodies


@pytest.mark.parametrize("model", ["Pinhole", "OpenCV", "OVFishEye62"])
@pytest.mark.parametrize("around_camera", [False, True])
def test_embree_finds_the_same_faces(model: str, around_camera: bool) -> None:
    num_same = 0
    for seed in range(4):
        surfaces, camera = merged(_pieces(seed, around_camera)), make_camera(model, size=(480, 360))
        lens, distances = LensRays.of(camera), np.full((360, 480), FAR_MM, np.float32)
        pixels, hits = cast_at(camera, lens, surfaces, distances)
        every = np.arange(480 * 360, dtype=np.int32)
        expected = surfaces.first_hits(camera.center_world_mm.astype(np.float32), lens.world(camera, every))
        faces = np.full(480 * 360, MISS)
        faces[pixels] = hits.faces
        assert (faces != expected.faces).mean() < 2e-4  # rays that pass an edge within rounding
        same = np.flatnonzero((faces == expected.faces) & (faces != MISS))
        num_same += len(same)
        place = np.searchsorted(pixels, same)
        np.testing.assert_allclose(hits.distances_mm[place], expected.distances_mm[same], rtol=1e-4)
        np.testing.assert_allclose(hits.weights[place], expected.weights[same], atol=5e-3)
        np.testing.assert_array_equal(distances.ravel()[pixels], hits.distances_mm)
    assert num_same > 5000


@pytest.mark.parametrize("model", ["Pinhole", "OpenCV", "OVFishEye62"])
def test_rays_between_those_that_agree_meet_the_same_face(model: str) -> None:
    for seed, size in [(0, (480, 360)), (1, (481, 361))]:
        surfaces, camera = merged(_pieces(seed, False)), make_camera(model, size=size)
        hits = cast_all(camera, LensRays.of(camera), surfaces)
        every = np.arange(size[0] * size[1], dtype=np.int32)
        rays = LensRays.of(camera).world(camera, every)
        expected = surfaces.first_hits(camera.center_world_mm.astype(np.float32), rays)
        assert (expected.faces != MISS).sum() > 5000
        assert (hits.faces != expected.faces).mean() < 3e-4  # tips of outlines that lie between rays
        same = np.flatnonzero((hits.faces == expected.faces) & (expected.faces != MISS))
        np.testing.assert_allclose(hits.distances_mm[same], expected.distances_mm[same], rtol=1e-4)
        np.testing.assert_allclose(hits.weights[same], expected.weights[same], atol=5e-3)


def test_every_second_ray_finds_the_nearest_of_large_faces_and_nothing_beside_them() -> None:
    camera, surfaces = make_camera(), merged([make_floor(size_mm=400.0)])
    hits = cast_all(camera, LensRays.of(camera), surfaces)
    x, y = np.rint(camera.project(np.array([[199.0, 0.0, 0.0], [202.0, 0.0, 0.0]]))).astype(int).T
    is_met = (hits.faces != MISS).reshape(240, 320)
    assert is_met[120, 160] and is_met[y[0], x[0]] and not is_met[y[1], x[1]] and not is_met[0, 0]
    assert (hits.distances_mm[~is_met.ravel()] == FAR_MM).all()


def test_only_what_is_nearer_is_found() -> None:
    surfaces, camera = merged([make_body(trimesh.creation.icosphere(3, 100.0), 1)]), make_camera()
    lens = LensRays.of(camera)
    for limit, is_found in [(899.0, False), (1001.0, True)]:
        pixels, _ = cast_at(camera, lens, surfaces, np.full((240, 320), limit, np.float32))
        assert (len(pixels) > 0) == is_found


def test_nothing_to_see() -> None:
    camera, distances = make_camera(), np.full((240, 320), FAR_MM, np.float32)
    for bodies in ([], [make_body(trimesh.creation.icosphere(2, 50.0), 1, (0.0, 1500.0, 0.0))]):
        pixels, hits = cast_at(camera, LensRays.of(camera), merged(bodies), distances)
        assert len(pixels) == len(hits.faces) == 0 and (distances == FAR_MM).all()
