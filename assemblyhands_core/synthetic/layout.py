"""How a take begins: what is mounted, what lies where, and where the hands are."""

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Rigid, free_key
from assemblyhands_core.synthetic.motion import WORLD, HandKey, PartKey
from assemblyhands_core.synthetic.person import SIDE
from assemblyhands_core.synthetic.placing import best_way, free_spots
from assemblyhands_core.synthetic.presenting import natural_rotation
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM


def lay_out(bench: Bench, is_building: bool) -> None:
    """Mount some parts, spread the others over the table, and place both hands."""
    rng, parts = bench.rng, bench.parts
    for hand in (bench.worker, bench.holder):
        bench.hand_keys[hand].append(free_key(0.0, resting(hand, rng)))
    share = rng.uniform(0.0, 0.6) if is_building else rng.uniform(0.6, 1.0)
    for name, part in parts.parts.items():
        mount = part.mount
        if (
            mount is not None
            and (mount.parent in bench.mounted or mount.parent == parts.root(name))
            and rng.random() < share
        ):
            out = 0.0 if rng.random() < 0.7 else mount.travel_mm
            bench.mounted[name] = (0.0, out)
            bench.carry(name, mount.parent, bench.T_parent_from_mounted(name, 0.0, out), 0.0)
        else:
            _put_on_table(bench, name)
    if rng.random() < 0.7:
        _start_holding(bench)


def _put_on_table(bench: Bench, name: str) -> None:
    """Let a part lie somewhere from the beginning."""
    rng, part = bench.rng, bench.part(name)
    is_workpiece = name == bench.parts.workpiece
    is_alone = part.mount is None and not bench.parts.children[name] and name != bench.parts.tool
    on_holders_side = is_alone and not is_workpiece and rng.random() < 0.4
    x, z = (70.0, 60.0) if is_workpiece else free_spots(bench, bench.holder if on_holders_side else bench.worker)[0]
    yaw = rng.normal(0.0, 0.3) if is_workpiece else rng.uniform(0.0, 2 * np.pi)
    bench.carry(name, WORLD, part.resting(x, z, float(yaw), TABLE_TOP_Y_MM), 0.0)


def _start_holding(bench: Bench) -> None:
    """Let the take begin with the workpiece in the hand, gripped as if from the table."""
    hand, name = bench.holder, bench.parts.workpiece
    ways = bench.ways(name, bench.part(name).pick, hand)
    held = ways.held(name, best_way(bench, hand, ways, bench.at(0.0).T_world_from(name)))
    wrist = transforms.rigid(natural_rotation(hand), np.array([20.0, 150.0, 80.0 + SIDE[hand] * 90.0]))
    grip = held.grip
    bench.hand_keys[hand][:] = [
        HandKey(0.0, WORLD, wrist @ grip.T_wrist_from_grip, grip.T_wrist_from_grip, grip.closed_rad)
    ]
    bench.part_keys[name][:] = [PartKey(0.0, hand, held.T_wrist_from_part)]
    bench.held[hand] = held


def resting(hand: Hand, rng: np.random.Generator) -> Rigid:
    """Palm down near the edge of the table."""
    side = SIDE[hand]
    y = np.array([0.86, 0.05, -0.30 * side])
    y /= np.linalg.norm(y)
    z = np.array([0.0, 1.0, 0.0]) - y * y[1]
    z /= np.linalg.norm(z)
    spot = np.array([rng.uniform(-160.0, -120.0), TABLE_TOP_Y_MM + 88.0, 80.0 + side * rng.uniform(190.0, 250.0)])
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), spot)


def beside_headset(hand: Hand) -> Rigid:
    """Fingertips at the side of the headset, as if to set it right."""
    side = SIDE[hand]
    y = np.array([0.05, 0.95, -0.30 * side])
    y /= np.linalg.norm(y)
    palm = np.array([0.15, 0.0, -1.0 * side])
    z = -(palm - y * (palm @ y))
    z /= np.linalg.norm(z)
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), np.array([-165.0, 330.0, 80.0 + side * 165.0]))
