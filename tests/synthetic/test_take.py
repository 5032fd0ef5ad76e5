"""Takes: repeatable, smooth, anatomical, and clear of what they should not go through."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.hands.kinematics import bone_lengths_mm, is_within_limits
from assemblyhands_core.synthetic.grips import FLESH_MM
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM, assembly_rig
from assemblyhands_core.synthetic.take import MAX_JOINT_SPEED_MM_S, State, Take

FRAME_RATE_HZ = 30.0
FLESH_OF_BOTH_MM = np.tile(FLESH_MM, 2)


def state_bytes(state: State) -> bytes:
    parts = b"".join(pose.tobytes() for pose in state.T_world_from_part.values())
    angles = b"".join(state.hands[hand].angles_rad.tobytes() for hand in HANDS)
    return state.joints_world_mm.tobytes() + state.T_headset_from_world.tobytes() + angles + parts


def test_the_same_seed_gives_the_same_bytes_in_any_order(take: Take) -> None:
    again = Take.from_seed(3, 6, 14.0)
    assert again.segments == take.segments
    times = [9.1, 0.0, 4.567, 13.9]
    forwards = {t: state_bytes(again.state_at(t)) for t in sorted(times)}
    assert all(state_bytes(take.state_at(t)) == forwards[t] for t in times)
    other = Take.from_seed(3, 7, 2.0)
    assert state_bytes(other.state_at(1.0)) != state_bytes(take.state_at(1.0))


def test_no_joint_jumps_or_exceeds_the_stated_speed(states: Sequence[State]) -> None:
    joints = np.stack([state.joints_world_mm for state in states])
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * FRAME_RATE_HZ
    assert 600.0 < speed.max() < MAX_JOINT_SPEED_MM_S
    assert np.abs(np.diff(speed, axis=0)).max() * FRAME_RATE_HZ < 40_000.0  # 4 g


def test_the_head_moves_a_little_and_slowly(states: Sequence[State]) -> None:
    heads = np.stack([transforms.inverse(state.T_headset_from_world)[:3, 3] for state in states])
    speed = np.linalg.norm(np.diff(heads, axis=0), axis=-1) * FRAME_RATE_HZ
    assert 5.0 < speed.max() < 400.0
    assert 5.0 < np.ptp(heads, axis=0).max() < 250.0


def test_bones_keep_their_lengths_and_joints_their_limits(take: Take, states: Sequence[State]) -> None:
    for state in states[::5]:
        for row in (state.joints_world_mm[:21], state.joints_world_mm[21:]):
            assert_allclose(bone_lengths_mm(row), take.subject.hand_shape.skeleton.bone_lengths_mm, rtol=1e-9)
        assert all(is_within_limits(state.hands[hand].angles_rad) for hand in HANDS)


def test_arms_end_in_the_hands(take: Take, states: Sequence[State]) -> None:
    for state in states[::10]:
        for hand, wrist in zip(HANDS, state.joints_world_mm[[20, 41]], strict=True):
            assert_allclose(state.posture.wrists_mm[hand], wrist)
            forearm = np.linalg.norm(state.posture.elbows_mm[hand] - wrist)
            assert forearm == pytest.approx(take.subject.forearm_mm)


def test_held_parts_move_rigidly_with_the_hand(take: Take) -> None:
    num_held = 0
    for name, track in take.tracks.parts.items():
        for key, following in zip(track.keys[:-1], track.keys[1:], strict=True):
            is_turned = key.carrier == following.carrier  # on the way to another grip
            if key.carrier not in HANDS or is_turned or following.t_s > take.duration_s:
                continue
            in_hand = []
            for t_s in np.linspace(key.t_s, following.t_s - 1e-6, 4):
                now = take.tracks.at(float(t_s))
                in_hand.append(transforms.inverse(now.T_world_from(key.carrier)) @ now.T_world_from(name))
            assert_allclose(in_hand, np.broadcast_to(in_hand[0], (4, 4, 4)), atol=1e-9)
            num_held += 1
    assert num_held >= 3


def test_parts_never_jump(states: Sequence[State]) -> None:
    for name in states[0].T_world_from_part:
        places = np.stack([state.T_world_from_part[name][:3, 3] for state in states])
        assert np.linalg.norm(np.diff(places, axis=0), axis=-1).max() * FRAME_RATE_HZ < MAX_JOINT_SPEED_MM_S, name


def test_hands_stay_above_the_table(states: Sequence[State]) -> None:
    joints = np.stack([state.joints_world_mm for state in states])
    skin = joints[..., 1] - FLESH_OF_BOTH_MM
    assert joints[..., 1].min() > TABLE_TOP_Y_MM - 3.0
    assert skin.min() > TABLE_TOP_Y_MM - 16.0 and np.mean(skin.min(axis=1) < TABLE_TOP_Y_MM - 6.0) < 0.05


def test_joints_stay_out_of_things(take: Take, desk_take: Take, states: Sequence[State]) -> None:
    """The deepest joint of each instant: fingertips may press into what they hold by some mm."""
    desk_states = [desk_take.state_at(t) for t in np.arange(0.0, desk_take.duration_s, 0.25).tolist()]
    deepest = [_deepest_mm(take, state) for state in states[::8]]
    deepest += [_deepest_mm(desk_take, state) for state in desk_states]
    assert np.mean(np.array(deepest) < -3.0) < 0.03
    assert min(deepest) > -15.0
    assert np.mean(np.array(deepest) < PAD_AND_MORE_MM) > 0.4  # and they do touch things


PAD_AND_MORE_MM = 8.0


def _deepest_mm(take: Take, state: State) -> float:
    return min(
        float(
            part.signed_distance_mm(
                transforms.apply(transforms.inverse(state.T_world_from_part[name]), state.joints_world_mm)
            ).min()
        )
        for name, part in take.parts.parts.items()
    )


def test_the_headset_sees_the_hands_most_of_the_time(states: Sequence[State]) -> None:
    rig = assembly_rig(1)
    seen = []
    for state in states[::6]:
        hands = state.joints_world_mm.reshape(2, 21, 3)
        views = [
            camera.contains(np.nan_to_num(camera.project(hands), nan=-1e6)).mean(axis=-1) > 0.8
            for camera in rig.ego_at(state.T_headset_from_world).values()
        ]
        seen.append(np.any(views, axis=0))
    assert np.mean(seen) > 0.9


def test_segments_are_in_order_within_the_take_and_in_the_states(take: Take, states: Sequence[State]) -> None:
    starts = [segment.start_s for segment in take.segments]
    assert starts == sorted(starts) and len(starts) >= 4
    for segment in take.segments:
        assert 0.0 <= segment.start_s < segment.end_s <= take.duration_s
        assert segment.noun == take.parts.parts[segment.part].noun
        middle = states[int(0.5 * (segment.start_s + segment.end_s) * FRAME_RATE_HZ)]
        assert segment in middle.segments


def test_states_exist_before_and_after(take: Take) -> None:
    assert np.isfinite(take.state_at(-1.0).joints_world_mm).all()
    assert np.isfinite(take.state_at(take.duration_s + 30.0).joints_world_mm).all()


def test_a_short_take_is_the_beginning_of_a_long_one(take: Take) -> None:
    short = Take.from_seed(3, 6, 3.0)
    assert state_bytes(short.state_at(2.0)) == state_bytes(take.state_at(2.0))
