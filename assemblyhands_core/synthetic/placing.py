"""Choosing where to grip, where to hold the workpiece and where to put things down: the most natural of many draws."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Rigid, Ways
from assemblyhands_core.synthetic.ergonomics import discomfort
from assemblyhands_core.synthetic.motion import rotation
from assemblyhands_core.synthetic.person import SIDE
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM

_WORK_WORLD_MM: Final = np.array([55.0, 165.0, 80.0])
_WORK_SPREAD_MM: Final = np.array([28.0, 28.0, 26.0])
_NUM_PRESENTATIONS: Final = 160
_TABLE_CLEARANCE_MM: Final = 7.0
_CLEARANCE_MM: Final = 9.0
_PART_CLEARANCE_MM: Final = 3.0
_HANDS_CLEARANCE_MM: Final = 24.0


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


def best_way(bench: Bench, hand: Hand, ways: Ways, T_world_from_part: Rigid) -> int:
    """Return the index of the most natural way to take hold of a part where it is, clear of the table."""
    cost = discomfort(bench.subject, hand, T_world_from_part @ ways.T_part_from_wrist)
    joints = transforms.apply(T_world_from_part, ways.joints_mm)
    return int(np.argmin(cost + _sunk_cost(joints) + _pierced_cost(ways) + bench.rng.uniform(0.0, 1.0, len(cost))))


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
    T_root_from_wrist = T_root_from_part[:, None] @ ways.T_part_from_wrist[:, None]
    roots = _presentations(bench, root, t_s)
    wrists = roots[:, None, None, None] @ T_root_from_wrist
    cost = discomfort(bench.subject, bench.worker, wrists).max(axis=-1)
    cost += 0.3 * np.maximum(TABLE_TOP_Y_MM + 25.0 - wrists[..., 1, 3], 0.0).max(axis=-1)
    cost += _obstacle_cost(bench, ways, root, t_s, T_root_from_part[:, 0], ignored) + _pierced_cost(ways) + way_cost
    cost += _moving_cost(bench, root, t_s, roots)[:, None, None]
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return Choice(roots[best[0]], int(best[1]), int(best[2]))


def _presentations(bench: Bench, root: str, t_s: float) -> Float64[np.ndarray, "k 4 4"]:
    """Draw poses of the workpiece from natural poses of the hand that holds it; the present one comes first."""
    now = bench.at(t_s).T_world_from(root)
    held = bench.held.get(bench.holder)
    if held is None or held.part != root:
        return now[None]
    side = SIDE[bench.holder]
    poses = [now]
    for _ in range(_NUM_PRESENTATIONS):
        turn = rotation(np.array([0.0, side * bench.rng.uniform(-1.4, 1.9), 0.0]))
        wrist = natural_rotation(bench.holder) @ rotation(bench.rng.normal(0.0, 0.35, 3)) @ turn
        root_pose = transforms.rigid(wrist @ held.T_wrist_from_part[:3, :3], np.zeros(3))
        root_pose[:3, 3] = _WORK_WORLD_MM + bench.rng.normal(0.0, 1.0, 3) * _WORK_SPREAD_MM
        poses.append(root_pose)
    return np.stack(poses)


def natural_rotation(hand: Hand) -> Float64[np.ndarray, "3 3"]:
    """The axes of a hand in front of the body with the thumb up, fingers ahead and a little inwards."""
    side = SIDE[hand]
    y = np.array([0.80, 0.15, -0.58 * side])
    y /= np.linalg.norm(y)
    thumb = np.array([0.0, 1.0, 0.0]) - y * y[1]
    x = -side * thumb / np.linalg.norm(thumb)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _moving_cost(bench: Bench, root: str, t_s: float, roots: Float64[np.ndarray, "k 4 4"]) -> Float64[np.ndarray, " k"]:
    """What holding the workpiece there costs: discomfort of the holding hand, and the way from here."""
    held = bench.held.get(bench.holder)
    if held is None or held.part != root:
        return np.zeros(len(roots))
    wrists = roots @ transforms.inverse(held.T_wrist_from_part)
    cosine = (np.einsum("kii->k", roots[0, :3, :3].T @ roots[:, :3, :3]) - 1) / 2
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    low = np.stack([transforms.apply(pose, bench.present_way(bench.holder).joints_mm[0])[:, 1].min() for pose in roots])
    low = np.maximum(TABLE_TOP_Y_MM + 30.0 - low, 0.0)
    away = np.linalg.norm(roots[:, :3, 3] - _WORK_WORLD_MM, axis=-1) / 60.0
    return np.asarray(discomfort(bench.subject, bench.holder, wrists) + 0.8 * turn + 0.3 * low + away**2)


def _obstacle_cost(
    bench: Bench,
    ways: Ways,
    root: str,
    t_s: float,
    T_root_from_part: Float64[np.ndarray, "place 4 4"],
    ignored: Sequence[str],
) -> Float64[np.ndarray, "place way"]:
    """What a working hand costs that runs into the workpiece, what is mounted on it or the other hand."""
    joints = np.stack([transforms.apply(place, ways.joints_mm) for place in T_root_from_part])
    now = bench.at(t_s)
    T_world_from_root = now.T_world_from(root)
    nearest = np.full(joints.shape[:2], np.inf)
    for name in (root, *bench.mounted):
        if bench.parts.root(name) == root and name not in ignored:
            T_part_from_root = transforms.inverse(now.T_world_from(name)) @ T_world_from_root
            distance = bench.part(name).signed_distance_mm(transforms.apply(T_part_from_root, joints))
            nearest = np.minimum(nearest, distance.min(axis=-1))
    cost = 0.4 * np.maximum(_CLEARANCE_MM - nearest, 0.0) ** 2
    held = bench.held.get(bench.holder)
    if held is not None and held.part == root:
        other = bench.present_way(bench.holder).joints_mm[0, :21]
        apart = np.linalg.norm(joints[..., None, :] - other, axis=-1).min(axis=(-1, -2))
        cost = cost + 0.1 * np.maximum(_HANDS_CLEARANCE_MM - apart, 0.0) ** 2
    return np.asarray(cost)


def _sunk_cost(joints_world_mm: Float64[np.ndarray, "*way 42 3"]) -> Float64[np.ndarray, "*way"]:
    """What fingers cost that reach into the table."""
    depth = TABLE_TOP_Y_MM + _TABLE_CLEARANCE_MM - joints_world_mm[..., 1]
    return np.asarray(0.5 * np.maximum(depth, 0.0).max(axis=-1) ** 2)


def _pierced_cost(ways: Ways) -> Float64[np.ndarray, " way"]:
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
    cost = discomfort(bench.subject, hand, poses[:, None] @ ways.T_part_from_wrist) + _pierced_cost(ways)
    cost += np.stack([_sunk_cost(transforms.apply(pose, ways.joints_mm)) for pose in poses])
    cost += bench.rng.uniform(0.0, 3.0, cost.shape)
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return poses[best[0]], int(best[1])


def free_spots(bench: Bench, hand: Hand) -> list[tuple[float, float]]:
    """Return places (x, z) on a hand's side of the table, as far from all other parts as there are any.

    At most 8 places; the distance asked for shrinks until there is one.
    """
    taken = [
        bench.at(bench.part_keys[name][-1].t_s).T_world_from(name)[[0, 2], 3]
        for name in bench.parts.parts
        if bench.is_on_table(name) and bench.part_keys[name]
    ]
    low, high = (105.0, 400.0) if SIDE[hand] > 0 else (-240.0, 55.0)
    drawn = np.stack([bench.rng.uniform(-60.0, 230.0, 60), bench.rng.uniform(low, high, 60)], axis=-1)
    apart = np.full(len(drawn), np.inf)
    for place in taken:
        apart = np.minimum(apart, np.linalg.norm(drawn - place, axis=-1))
    order = np.argsort(-np.minimum(apart, 95.0), kind="stable")[:8]
    return [(float(x), float(z)) for x, z in drawn[order]]
