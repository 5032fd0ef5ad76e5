"""Choosing how the holding hand presents the workpiece to the working hand: the most natural of many draws."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Held, Rigid, Ways
from assemblyhands_core.synthetic.clearance import apart_mm, nearest_mm
from assemblyhands_core.synthetic.ergonomics import discomfort
from assemblyhands_core.synthetic.motion import rotation
from assemblyhands_core.synthetic.person import SIDE
from assemblyhands_core.synthetic.placing import CLEARANCE_MM, pierced_cost
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM

_WORK_WORLD_MM: Final = np.array([55.0, 165.0, 80.0])
_WORK_SPREAD_MM: Final = np.array([28.0, 28.0, 26.0])
_NUM_DRAWN: Final = 140
_REFINEMENTS: Final = ((60, 0.30, 18.0), (50, 0.12, 8.0))
"""How many more are drawn around the best so far, turned (rad) and shifted (mm) by how much."""
_HANDS_CLEARANCE_MM: Final = 3.0
_FROM_BELOW_COST: Final = 4.0
_HOPELESS: Final = 12.0
"""Ways that cost this much more than the best one, wherever the workpiece is held, are left out."""


class Choice(NamedTuple):
    """Where the workpiece is held and how the other hand grips.

    Attributes:
        T_world_from_root: The workpiece (or whatever the part is mounted on).
        place: Index of the chosen place of the part.
        way: Index of the chosen way to hold it.
    """

    T_world_from_root: Rigid
    place: int
    way: int


def best_presentation(
    bench: Bench,
    ways: Ways,
    root: str,
    t_s: float,
    T_root_from_part: Float64[np.ndarray, "place stroke 4 4"],
    ignored: Sequence[str],
    way_cost: Float64[np.ndarray, " way"] | float = 0.0,
) -> Choice:
    """Choose how the holding hand presents the workpiece and how the working hand grips.

    Args:
        bench: State; a root that is not held stays where it is.
        ways: How the working hand may grip.
        root: What the part is mounted on in the end.
        t_s: Until when the script goes.
        T_root_from_part: Where the part may be; with more than one stroke all of them have to be comfortable.
        ignored: Parts that the working hand may touch.
        way_cost: Of each way.
    """
    obstacles = _obstacle_cost(bench, ways, root, t_s, T_root_from_part[:, 0], ignored)
    fixed = obstacles + pierced_cost(ways) + way_cost
    place, way = np.nonzero(fixed <= fixed.min() + _HOPELESS)
    T_root_from_wrist = T_root_from_part[place] @ ways.T_part_from_wrist[way][:, None]
    now = bench.at(t_s).T_world_from(root)
    held = bench.held.get(bench.holder)
    if held is None or held.part != root:
        cost = _working_cost(bench, now[None], T_root_from_wrist) + fixed[place, way]
        index = int(np.argmin(cost))
        return Choice(now, int(place[index]), int(way[index]))
    best, index, least = now, 0, np.inf
    for round_ in range(1 + len(_REFINEMENTS)):
        roots = _drawn(bench, held, now) if round_ == 0 else _around(bench, best, *_REFINEMENTS[round_ - 1])
        cost = _working_cost(bench, roots, T_root_from_wrist) + fixed[place, way]
        cost += _facing_cost(roots, T_root_from_part[place, 0])
        cost += _holding_cost(bench, held, now, roots)[:, None]
        found = np.unravel_index(int(np.argmin(cost)), cost.shape)
        if cost[found] < least:
            best, index, least = roots[found[0]], int(found[1]), float(cost[found])
    return Choice(best, int(place[index]), int(way[index]))


def _drawn(bench: Bench, held: Held, now: Rigid) -> Float64[np.ndarray, "k 4 4"]:
    """Draw poses of the workpiece from natural poses of the hand that holds it; the present one comes first."""
    side = SIDE[bench.holder]
    poses = [now]
    for _ in range(_NUM_DRAWN):
        turn = rotation(np.array([0.0, side * bench.rng.uniform(-1.4, 1.9), 0.0]))
        wrist = natural_rotation(bench.holder) @ rotation(bench.rng.normal(0.0, 0.4, 3)) @ turn
        place = _WORK_WORLD_MM + bench.rng.normal(0.0, 1.0, 3) * _WORK_SPREAD_MM
        poses.append(transforms.rigid(wrist @ held.T_wrist_from_part[:3, :3], place))
    return np.stack(poses)


def _around(bench: Bench, pose: Rigid, number: int, turn_rad: float, shift_mm: float) -> Float64[np.ndarray, "k 4 4"]:
    """Draw poses of the workpiece near one."""
    turns, shifts = bench.rng.normal(0.0, turn_rad, (number, 3)), bench.rng.normal(0.0, shift_mm, (number, 3))
    return np.stack(
        [
            transforms.rigid(rotation(turn) @ pose[:3, :3], pose[:3, 3] + shift)
            for turn, shift in zip(turns, shifts, strict=True)
        ]
    )


def natural_rotation(hand: Hand) -> Float64[np.ndarray, "3 3"]:
    """The axes of a hand in front of the body with the thumb up, fingers ahead and a little inwards."""
    side = SIDE[hand]
    y = np.array([0.80, 0.15, -0.58 * side])
    y /= np.linalg.norm(y)
    thumb = np.array([0.0, 1.0, 0.0]) - y * y[1]
    x = -side * thumb / np.linalg.norm(thumb)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _working_cost(
    bench: Bench, roots: Float64[np.ndarray, "k 4 4"], T_root_from_wrist: Float64[np.ndarray, "way stroke 4 4"]
) -> Float64[np.ndarray, "k way"]:
    """What it costs the working hand to work there, at the worst of its strokes."""
    wrists = roots[:, None, None] @ T_root_from_wrist
    low = np.maximum(TABLE_TOP_Y_MM + 50.0 - wrists[..., 1, 3], 0.0) / 8.0
    return np.asarray((discomfort(bench.subject, bench.worker, wrists) + low**2).max(axis=-1))


def _facing_cost(
    roots: Float64[np.ndarray, "k 4 4"], T_root_from_part: Float64[np.ndarray, "way 4 4"]
) -> Float64[np.ndarray, "k way"]:
    """What it costs to work from below, where one sees little: parts are put on along their -z."""
    outwards_up = roots[:, None, 1, :3] @ T_root_from_part[:, :3, 2].T
    return np.asarray(_FROM_BELOW_COST * np.maximum(0.35 - outwards_up[:, 0], 0.0))


def _holding_cost(
    bench: Bench, held: Held, now: Rigid, roots: Float64[np.ndarray, "k 4 4"]
) -> Float64[np.ndarray, " k"]:
    """What holding the workpiece there costs: discomfort of the holding hand, and the way from here."""
    wrists = roots @ transforms.inverse(held.T_wrist_from_part)
    cosine = (np.einsum("ij,kij->k", now[:3, :3], roots[:, :3, :3]) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    joints = bench.present_way(bench.holder).joints_mm[0, :21]
    low = np.stack([transforms.apply(pose, joints)[:, 1].min() for pose in roots])
    low = np.maximum(TABLE_TOP_Y_MM + 30.0 - low, 0.0) / 8.0
    away = np.linalg.norm(roots[:, :3, 3] - _WORK_WORLD_MM, axis=-1) / 60.0
    return np.asarray(discomfort(bench.subject, bench.holder, wrists) + 0.8 * turn + low**2 + away**2)


def _obstacle_cost(
    bench: Bench,
    ways: Ways,
    root: str,
    t_s: float,
    T_root_from_part: Float64[np.ndarray, "place 4 4"],
    ignored: Sequence[str],
) -> Float64[np.ndarray, "place way"]:
    """What a working hand costs that runs into the workpiece, what is mounted on it or the other hand."""
    now = bench.at(t_s)
    joints = np.stack([transforms.apply(place, ways.joints_mm) for place in T_root_from_part])
    names = [name for name in (root, *bench.mounted) if bench.parts.root(name) == root and name not in ignored]
    nearest = nearest_mm(bench, now, names, transforms.apply(now.T_world_from(root), joints))
    cost = 0.4 * np.maximum(CLEARANCE_MM - nearest, 0.0) ** 2
    held = bench.held.get(bench.holder)
    if held is not None and held.part == root:
        other = bench.present_way(bench.holder).joints_mm[0, :21]
        apart = apart_mm(joints, other)
        cost = cost + 0.2 * np.maximum(_HANDS_CLEARANCE_MM - apart, 0.0) ** 2
    return np.asarray(cost)
