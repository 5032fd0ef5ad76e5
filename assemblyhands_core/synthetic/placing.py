"""Choosing how to take hold of things and where to put them down: the most natural of many draws."""

from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Rigid, Ways
from assemblyhands_core.synthetic.clearance import nearest_mm
from assemblyhands_core.synthetic.ergonomics import discomfort
from assemblyhands_core.synthetic.grips import FLESH_MM
from assemblyhands_core.synthetic.person import SIDE
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM

CLEARANCE_MM: Final = 2.0
"""That skin should keep from what it does not touch."""
_PART_CLEARANCE_MM: Final = -1.0
_NEIGHBOURS_MM: Final = 230.0
_NUM_CHECKED: Final = 12
_CHECKED_BONUS: Final = 1e3


def best_way(bench: Bench, hand: Hand, ways: Ways, T_world_from_part: Rigid) -> int:
    """Return the index of the most natural way to take hold of a part where it is, clear of the table."""
    cost = discomfort(bench.subject, hand, T_world_from_part @ ways.T_part_from_wrist)
    joints = transforms.apply(T_world_from_part, ways.joints_mm)
    nearest = nearest_mm(bench, bench.at(bench.end_s(hand)), _lying(bench, T_world_from_part), joints)
    cost += _sunk_cost(joints) + pierced_cost(ways) + 0.2 * np.maximum(CLEARANCE_MM - nearest, 0.0) ** 2
    return int(np.argmin(cost + bench.rng.uniform(0.0, 1.0, len(cost))))


def _sunk_cost(joints_world_mm: Float64[np.ndarray, "*way 63 3"]) -> Float64[np.ndarray, "*way"]:
    """What fingers cost that reach into the table."""
    depth = TABLE_TOP_Y_MM + np.tile(FLESH_MM, 3) - joints_world_mm[..., 1]
    return np.asarray(0.5 * np.maximum(depth, 0.0).max(axis=-1) ** 2)


def pierced_cost(ways: Ways) -> Float64[np.ndarray, " way"]:
    """What fingers cost that reach into what they hold."""
    return np.asarray(0.5 * np.maximum(_PART_CLEARANCE_MM - ways.clearance_mm, 0.0) ** 2)


def best_spot(bench: Bench, hand: Hand, ways: Ways, name: str) -> tuple[Rigid, int]:
    """Choose a free place on the table, how to turn a part there and which way to hold it while putting it down.

    Returns:
        `T_world_from_part` and the index of the way.
    """
    spots = free_spots(bench, hand)
    yaws = bench.rng.uniform(0.0, 2 * np.pi, 10)
    part = bench.part(name)
    poses = np.stack([part.resting(x, z, float(yaw), TABLE_TOP_Y_MM) for x, z in spots for yaw in yaws])
    cost = discomfort(bench.subject, hand, poses[:, None] @ ways.T_part_from_wrist) + pierced_cost(ways)
    cost += np.stack([_sunk_cost(transforms.apply(pose, ways.joints_mm)) for pose in poses])
    cost += bench.rng.uniform(0.0, 3.0, cost.shape)
    now = bench.at(bench.end_s(hand))
    for index in np.argsort(cost, axis=None)[:_NUM_CHECKED]:
        pose, way = (int(i) for i in np.unravel_index(index, cost.shape))
        nearest = nearest_mm(bench, now, _lying(bench, poses[pose]), transforms.apply(poses[pose], ways.joints_mm[way]))
        cost[pose, way] += 0.2 * max(CLEARANCE_MM - float(nearest), 0.0) ** 2 - _CHECKED_BONUS
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return poses[best[0]], int(best[1])


def _lying(bench: Bench, T_world_from_part: Rigid) -> list[str]:
    """The other parts on the table around a place."""
    lying = [name for name in bench.parts.parts if bench.is_on_table(name) and bench.part_keys[name]]
    places = {name: bench.part_keys[name][-1].T_carrier_from_part[:3, 3] for name in lying}
    return [name for name in lying if 1.0 < np.linalg.norm(places[name] - T_world_from_part[:3, 3]) < _NEIGHBOURS_MM]


def free_spots(bench: Bench, hand: Hand) -> list[tuple[float, float]]:
    """Return places (x, z) on a hand's side of the table, as far from all other parts as there are any.

    At most 8 places; the distance asked for shrinks until there is one.
    """
    taken = [
        bench.at(bench.part_keys[name][-1].t_s).T_world_from(name)[[0, 2], 3]
        for name in bench.parts.parts
        if bench.is_on_table(name) and bench.part_keys[name]
    ]
    low, high = (135.0, 410.0) if SIDE[hand] > 0 else (-250.0, 25.0)
    drawn = np.stack([bench.rng.uniform(30.0, 260.0, 60), bench.rng.uniform(low, high, 60)], axis=-1)
    apart = np.full(len(drawn), np.inf)
    for place in taken:
        apart = np.minimum(apart, np.linalg.norm(drawn - place, axis=-1))
    order = np.argsort(-np.minimum(apart, 95.0), kind="stable")[:8]
    return [(float(x), float(z)) for x, z in drawn[order]]
