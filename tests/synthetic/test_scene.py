"""Scenes: closed bodies with ids, static ones the same in all, cameras outside of what they film."""

from collections.abc import Sequence

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.bodies import Body
from assemblyhands_core.synthetic.figure import HAND_IDS, HEADSET_ID
from assemblyhands_core.synthetic.rig import assembly_rig, desktop_rig
from assemblyhands_core.synthetic.scene import FIRST_PART_ID, scene_at
from assemblyhands_core.synthetic.take import State, Take


def is_closed(body: Body) -> bool:
    edges = np.concatenate([body.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    forth, back = (np.sort(e[:, 0].astype(np.int64) * 10**6 + e[:, 1]) for e in (edges, edges[:, ::-1]))
    return bool((forth == back).all())


def volume_mm3(body: Body) -> float:
    a, b, c = (body.vertices_mm[body.faces[:, i]].astype(np.float64) for i in range(3))
    return float((np.cross(a, b) * c).sum() / 6)


def test_all_bodies_are_closed_and_wind_outwards(take: Take, desk_take: Take) -> None:
    for one in (take, desk_take):
        scene = scene_at(one, 3.0)
        for body in (*scene.static, *scene.moving):
            assert is_closed(body), body.name
            assert volume_mm3(body) > 0, body.name
            assert 0.0 <= body.albedo.min() <= body.albedo.max() <= 1.0, body.name


def test_hands_are_drawn_around_their_joints(take: Take, states: Sequence[State]) -> None:
    state = states[90]
    bodies = {body.object_id: body for body in scene_at(take, state.t_s).moving if body.object_id in (1, 2)}
    for hand, joints in (("right", state.joints_world_mm[:21]), ("left", state.joints_world_mm[21:])):
        skin = bodies[HAND_IDS[hand]].vertices_mm
        nearest = np.linalg.norm(skin[None] - joints[:, None], axis=-1).min(axis=1)
        assert nearest.max() < 25.0
        assert np.abs(skin.mean(axis=0) - joints.mean(axis=0)).max() < 60.0


def test_static_bodies_are_the_same_objects_at_all_instants(take: Take) -> None:
    one, other = scene_at(take, 1.0), scene_at(take, 5.0)
    assert one.static is other.static and one.lights is other.lights and one.seed == other.seed
    moved = [
        a for a, b in zip(one.moving, other.moving, strict=True) if not np.array_equal(a.vertices_mm, b.vertices_mm)
    ]
    assert {"right hand", "left hand", "head", "right forearm"} <= {body.name for body in moved}


def test_the_same_instant_gives_the_same_bytes(take: Take) -> None:
    one, again = scene_at(take, 2.5), scene_at(Take.from_seed(3, 6, 14.0), 2.5)
    for a, b in zip((*one.moving, *one.static), (*again.moving, *again.static), strict=True):
        assert a.vertices_mm.tobytes() == b.vertices_mm.tobytes() and a.albedo.tobytes() == b.albedo.tobytes()


def test_every_part_has_an_id_of_its_own_and_only_vehicles_need_a_headset(take: Take, desk_take: Take) -> None:
    ids = [body.object_id for body in scene_at(take, 0.0).moving if body.object_id >= FIRST_PART_ID]
    assert ids == list(range(FIRST_PART_ID, FIRST_PART_ID + len(take.parts.parts)))
    assert HEADSET_ID in {body.object_id for body in scene_at(take, 0.0).moving}
    assert HEADSET_ID not in {body.object_id for body in scene_at(desk_take, 0.0).moving}


def test_no_camera_is_inside_anything(take: Take, desk_take: Take, states: Sequence[State]) -> None:
    for one, rig in ((take, assembly_rig(1)), (desk_take, desktop_rig(1))):
        state = one.state_at(4.0)
        scene = scene_at(one, 4.0)
        for camera_id, camera in rig.cameras_at(state.T_headset_from_world).items():
            for body in (*scene.static, *scene.moving):
                assert _winding(body, camera.center_world_mm) < 0.5, (camera_id, body.name)


def _winding(body: Body, point_mm: np.ndarray) -> float:
    """How often a closed mesh winds around a point: 1 inside, 0 outside (Van Oosterom & Strackee 1983)."""
    corners = body.vertices_mm[body.faces].astype(np.float64) - point_mm
    a, b, c = (corners[:, i] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    above = (np.cross(a, b) * c).sum(-1)
    below = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return float(2 * np.arctan2(above, below).sum() / (4 * np.pi))


def test_the_winding_number_tells_inside_from_outside(take: Take) -> None:
    table = next(body for body in scene_at(take, 0.0).static if body.name == "table")
    assert abs(_winding(table, np.array([100.0, -35.0, 80.0])) - 1.0) < 1e-6
    assert abs(_winding(table, np.array([100.0, 35.0, 80.0]))) < 1e-6


def test_parts_are_drawn_where_the_state_says(take: Take, states: Sequence[State]) -> None:
    state = states[30]
    drawn = {body.name: body for body in scene_at(take, state.t_s).moving}
    for name, part in take.parts.parts.items():
        wanted = transforms.apply(state.T_world_from_part[name], part.vertices_mm)
        assert np.abs(drawn[name].vertices_mm - wanted).max() < 1e-3
