"""Keeping hands out of things, out of the table and out of one another."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import HandPose, forward_kinematics
from assemblyhands_core.synthetic.bench import Bench
from assemblyhands_core.synthetic.grips import FLESH_MM
from assemblyhands_core.synthetic.motion import HandKey, Instant
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM

_SHARES: Final = (0.2, 0.35, 0.5, 0.65, 0.8)
_PARTS_MM: Final = 0.0
_HANDS_MM: Final = 1.0
_TABLE_MM: Final = 0.0
_MAX_JOINT_SPEED_MM_S: Final = 1800.0
_NUM_TIMES: Final = 13
_NUM_SLOWINGS: Final = 4
_DETOUR_COST: Final = 0.0015
_DETOURS_MM: Final = (
    *((0.0, 60.0, 0.0), (0.0, 110.0, 0.0), (0.0, 170.0, 0.0), (-70.0, 40.0, 0.0), (70.0, 40.0, 0.0)),
    *((0.0, 40.0, 80.0), (0.0, 40.0, -80.0), (-60.0, 90.0, 60.0), (-60.0, 90.0, -60.0)),
)


def nearest_mm(
    bench: Bench, now: Instant, names: Iterable[str], joints_world_mm: Float64[np.ndarray, "*batch joint 3"]
) -> Float64[np.ndarray, "*batch"]:
    """Return the least distance of the skin to the surface of any of some parts: negative inside, inf without any.

    Args:
        bench: State.
        now: An instant.
        names: Parts.
        joints_world_mm: Of a hand, once or more often one after the other.
    """
    flesh = np.tile(FLESH_MM, joints_world_mm.shape[-2] // len(FLESH_MM))
    nearest = np.full(joints_world_mm.shape[:-2], np.inf)
    for name in names:
        T_part_from_world = transforms.inverse(now.T_world_from(name))
        distance = bench.part(name).signed_distance_mm(transforms.apply(T_part_from_world, joints_world_mm))
        nearest = np.minimum(nearest, (distance - flesh).min(axis=-1))
    return np.asarray(nearest)


def apart_mm(
    one_mm: Float64[np.ndarray, "*batch joint 3"], other_mm: Float64[np.ndarray, "21 3"]
) -> Float64[np.ndarray, "*batch"]:
    """Return the least distance between the skins of two hands, negative where they meet, for each of a batch."""
    flesh = np.tile(FLESH_MM, one_mm.shape[-2] // len(FLESH_MM))
    distance = np.linalg.norm(one_mm[..., None, :] - other_mm, axis=-1) - flesh[:, None] - FLESH_MM
    return np.asarray(distance.min(axis=(-1, -2)))


def travel(bench: Bench, hand: Hand, key: HandKey) -> float:
    """Move a hand to a key, on a detour where the straight way leads through something; returns when it is there."""
    best, least = key, np.inf
    for detour in ((0.0, 0.0, 0.0), *_DETOURS_MM):
        tried = replace(key, arc_mm=np.array(key.arc_mm) + detour)
        harm = _harm_on_the_way(bench, hand, tried)
        cost = harm + _DETOUR_COST * float(np.dot(detour, detour))
        if cost < least:
            best, least = tried, cost
        if least <= _DETOUR_COST * 60.0**2 and harm == 0.0:
            break
    return _unhurried(bench, hand, best)


def _unhurried(bench: Bench, hand: Hand, key: HandKey) -> float:
    """Move a hand to a key, later if a joint would be too fast, also by being carried along by the other hand."""
    start_s = bench.end_s(hand)
    for _ in range(_NUM_SLOWINGS):
        end_s = bench.move(hand, key)
        times = np.linspace(start_s, end_s, _NUM_TIMES)
        joints = np.stack([hand_joints_mm(bench, hand, bench.at(t_s)) for t_s in times.tolist()])
        peak = float(np.linalg.norm(np.diff(joints, axis=0), axis=-1).max()) / (end_s - start_s) * (_NUM_TIMES - 1)
        if peak <= _MAX_JOINT_SPEED_MM_S:
            break
        bench.hand_keys[hand].pop()
        key = replace(key, t_s=start_s + (end_s - start_s) * 1.05 * peak / _MAX_JOINT_SPEED_MM_S)
    else:
        end_s = bench.move(hand, key)
    return end_s


def hand_joints_mm(bench: Bench, hand: Hand, now: Instant) -> Float64[np.ndarray, "21 3"]:
    """Return the joints of a hand at an instant, world."""
    pose = HandPose(hand, now.T_world_from(hand), now.angles_rad(hand))
    return forward_kinematics(bench.subject.hand_shape.skeleton, pose)


def harm_at(bench: Bench, hand: Hand, key: HandKey) -> float:
    """Return how far a hand would be in things at a key, squared and summed."""
    end_s = bench.move(hand, key)
    harm = _harm(bench, hand, bench.at(end_s))
    bench.hand_keys[hand].pop()
    return harm


def _harm_on_the_way(bench: Bench, hand: Hand, key: HandKey) -> float:
    """How far a hand would go into things between its last key and this one, squared and summed."""
    start_s = bench.end_s(hand)
    end_s = bench.move(hand, key)
    harm = sum(_harm(bench, hand, bench.at(start_s + share * (end_s - start_s))) for share in _SHARES)
    bench.hand_keys[hand].pop()
    return harm


def _harm(bench: Bench, hand: Hand, now: Instant) -> float:
    joints = {one: hand_joints_mm(bench, one, now) for one in HANDS}
    palm = joints[hand].mean(axis=0)
    near = [
        name
        for name, part in bench.parts.parts.items()
        if float(np.linalg.norm(now.T_world_from(name)[:3, 3] - palm)) < part.radius_mm + 130.0
        and bench.carrier(name) != hand
    ]
    other: Hand = "left" if hand == "right" else "right"
    apart = apart_mm(joints[hand], joints[other])
    low = float((joints[hand][:, 1] - FLESH_MM).min()) - TABLE_TOP_Y_MM
    carried = [name for name in bench.parts.parts if bench.carrier(name) == hand]
    gaps = (
        _PARTS_MM - float(nearest_mm(bench, now, carried, joints[other])),
        _PARTS_MM - float(nearest_mm(bench, now, near, joints[hand])),
        _HANDS_MM - apart,
        _TABLE_MM - low,
    )
    return float(sum((max(float(gap), 0.0) ** 2 for gap in gaps), 0.0))
