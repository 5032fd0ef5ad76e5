"""Which points cameras see, by hand and against the id mask."""

import numpy as np
from drawn_scenes import PLAIN, make_camera, make_floor, make_scene, make_sphere

from assemblyhands_core.synthetic.render import render, visibility


def test_a_point_is_seen_through_its_own_skin_only_and_not_too_deep() -> None:
    hand, other, wall = make_sphere(1, (0, 100, 0), 40.0), make_sphere(2, (0, 300, 100), 40.0), make_floor()
    scene = make_scene((wall,), (hand, other))
    points = np.array(
        [
            [0.0, 120.0, 0.0],  # 20 mm below the skin
            [0.0, 110.0, 0.0],  # 30 mm below
            [0.0, 140.0, 0.0],  # on the skin
            [0.0, 150.0, 0.0],  # above it: the ray still meets the hand first, behind the point
            [0.0, 70.0, 80.0],  # behind the other hand
            [0.0, 320.0, 100.0],  # in the other hand
            [0.0, 320.0, 100.0],  # the same, but said to be of the first
            [3000.0, 120.0, 0.0],  # outside the picture
            [0.0, 2000.0, 0.0],  # behind the camera
            [0.0, -15.0, 200.0],  # in the floor
        ]
    )
    owners = np.array([1, 1, 1, 1, 1, 2, 1, 1, 1, 1], dtype=np.uint8)
    seen = visibility(scene, [make_camera()], points, owners)
    assert seen.tolist() == [[True, False, True, True, False, True, False, False, False, False]]
    assert visibility(scene, [make_camera()], points, owners, tolerance_mm=35.0)[0, 1]


def test_static_bodies_hide_too() -> None:
    hand, lid = make_sphere(1, (0, 100, 0), 40.0), make_sphere(9, (0, 400, 0), 50.0)
    point, owner = np.array([[0.0, 130.0, 0.0]]), np.array([1])
    assert visibility(make_scene((), (hand,)), [make_camera()], point, owner).all()
    assert not visibility(make_scene((lid,), (hand,)), [make_camera()], point, owner).any()


def test_the_id_mask_agrees() -> None:
    generator = np.random.default_rng(3)
    centers = generator.uniform((-250, 60, -200), (250, 400, 200), (12, 3))
    balls = tuple(make_sphere(k + 1, tuple(center), 50.0) for k, center in enumerate(centers))
    scene, cameras = make_scene((make_floor(),), balls), [make_camera(m) for m in ("OpenCV", "OVFishEye62")]
    owners = np.repeat(np.arange(1, 13), 40)
    directions = generator.normal(size=(len(owners), 3))
    points = centers[owners - 1] + 48.0 * directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    seen = visibility(scene, cameras, points, owners, tolerance_mm=6.0)
    for camera, row in zip(cameras, seen, strict=True):
        ids = render(scene, camera, sensor=PLAIN, frame_seed=0).object_id
        inside = camera.contains(camera.project(points))
        x, y = np.rint(camera.project(points[inside])).astype(int).T
        shows_owner = ids[y, x] == owners[inside]
        assert shows_owner[row[inside]].mean() > 0.97  # but for half pixels at outlines
        towards = camera.center_world_mm - points[inside]
        outwards = directions[inside] / np.linalg.norm(directions[inside], axis=-1, keepdims=True)
        cosine = np.einsum("pk,pk->p", towards / np.linalg.norm(towards, axis=-1, keepdims=True), outwards)
        assert row[inside][shows_owner & (cosine > 0.5)].mean() > 0.97 and not row[inside][cosine < 0.0].any()


def test_no_cameras_and_no_points() -> None:
    scene = make_scene((), (make_sphere(1, (0, 100, 0), 40.0),))
    assert visibility(scene, [], np.zeros((3, 3)), np.ones(3, int)).shape == (0, 3)
    assert visibility(scene, [make_camera()], np.zeros((0, 3)), np.ones(0, int)).shape == (1, 0)
