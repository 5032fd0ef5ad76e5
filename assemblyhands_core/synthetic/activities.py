"""Scripts of takes: which verb comes next, for whom and how long, drawn from what is possible on the bench.

Designed frequencies (share of segments, over many assembly takes): pick up 0.31, position 0.22, put down 0.20, remove
0.11, screw 0.10, unscrew 0.06; screw and unscrew last some seconds, the others about one. What is taken is put
somewhere: pick up + remove = position + put down.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Rigid, Verb, free_key
from assemblyhands_core.synthetic.clearance import travel
from assemblyhands_core.synthetic.motion import WORLD, HandKey, PartKey
from assemblyhands_core.synthetic.moves import pick_up, position, put_down, remove
from assemblyhands_core.synthetic.objects import PartSet
from assemblyhands_core.synthetic.person import SIDE, Subject
from assemblyhands_core.synthetic.placing import best_way, free_spots
from assemblyhands_core.synthetic.presenting import natural_rotation
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM
from assemblyhands_core.synthetic.turning import turn_screw

VERBS: Final[tuple[Verb, ...]] = ("pick up", "position", "put down", "remove", "screw", "unscrew")
"""In the order of designed frequency."""

_AWAY_CHANCE: Final = 0.05
_SET_ASIDE_CHANCE: Final = 0.05
_CHANGE_OF_MIND: Final = 0.06


class Option(NamedTuple):
    """Something that can be done next."""

    verb: Verb
    part: str
    weight: float


def write_script(subject: Subject, parts: PartSet, rng: np.random.Generator, duration_s: float) -> Bench:
    """Script a take from an instant in the middle of some work to at least its end.

    Args:
        subject: Who works.
        parts: What with.
        rng: Decides on everything; same state, same script.
        duration_s: Until when there has to be a script.
    """
    bench = Bench(subject, parts, rng, tempo=float(rng.uniform(0.85, 1.25)))
    is_building = bool(rng.random() < 0.62)
    _lay_out(bench, is_building)
    t_s = float(rng.uniform(0.0, 0.4))
    while t_s < duration_s:
        choices = options(bench, is_building)
        if not choices or rng.random() < _CHANGE_OF_MIND:
            is_building = not is_building
            choices = options(bench, is_building) or options(bench, not is_building)
        t_s = _pause(bench, _perform(bench, _drawn(choices, rng), t_s))
    return bench


def options(bench: Bench, is_building: bool) -> list[Option]:
    """Return what the working hand can do next (or the holding hand has to), with weights; never empty for long.

    Args:
        bench: State.
        is_building: Whether the toy is being put together or taken apart.
    """
    if not any(held.part == bench.parts.workpiece for held in bench.held.values()):
        return [Option("pick up", bench.parts.workpiece, 1.0)]
    held = bench.held.get(bench.worker)
    if held is None:
        return [*_taking(bench, is_building), *_turning(bench, is_building, by_tool=False)]
    if held.part == bench.parts.tool:
        turning = _turning(bench, is_building, by_tool=True)
        return [*turning, Option("put down", held.part, 0.7)]
    put_down_weight = 0.6 if is_building else 6.0
    if _can_be_mounted(bench, held.part):
        return [
            Option("position", held.part, 5.0 if is_building else 0.4),
            Option("put down", held.part, put_down_weight),
        ]
    return [Option("put down", held.part, 1.0)]


def _taking(bench: Bench, is_building: bool) -> list[Option]:
    """Parts to take from the table or off the toy, and the tool."""
    found = []
    num_screws = len(_turning(bench, is_building, by_tool=True))
    for name in bench.parts.parts:
        if bench.is_on_table(name) and name == bench.parts.tool:
            found.append(Option("pick up", name, 2.2 * min(num_screws, 2)))
        elif bench.is_on_table(name) and not bench.mounted_children(name):
            useful = is_building and _can_be_mounted(bench, name)
            found.append(Option("pick up", name, 1.5 if useful else 0.12))
        elif bench.is_loose(name) and not bench.mounted_children(name):
            found.append(Option("remove", name, 0.12 if is_building else 2.5))
    return [option for option in found if option.weight > 0]


def _turning(bench: Bench, is_building: bool, by_tool: bool) -> list[Option]:
    """Screws to turn."""
    found = []
    for name, part in bench.parts.parts.items():
        if part.mount is None or part.mount.travel_mm == 0 or name not in bench.mounted:
            continue
        weight = 3.0 if by_tool else 0.5
        if bench.is_loose(name):
            found.append(Option("screw", name, weight if is_building else 0.02 * weight))
        else:
            found.append(Option("unscrew", name, 0.03 * weight if is_building else weight))
    return found


def _can_be_mounted(bench: Bench, name: str) -> bool:
    """Tell whether what a part belongs on is there: held, or a mounted part, or standing on the table."""
    mount = bench.part(name).mount
    if mount is None:
        return False
    root = bench.parts.root(name)
    return mount.parent in bench.mounted or (mount.parent == root and _is_workable(bench, root))


def _is_workable(bench: Bench, root: str) -> bool:
    held = bench.held.get(bench.holder)
    return (held is not None and held.part == root) or (root != bench.parts.workpiece and bench.is_on_table(root))


def _drawn(choices: list[Option], rng: np.random.Generator) -> Option:
    weights = np.array([option.weight for option in choices])
    return choices[int(rng.choice(len(choices), p=weights / weights.sum()))]


def _perform(bench: Bench, option: Option, t_s: float) -> float:
    """Script one action; returns when the working hand is free."""
    hand = bench.holder if option.part == bench.parts.workpiece else bench.worker
    if option.verb in ("screw", "unscrew"):
        return turn_screw(bench, option.part, t_s, _num_strokes(bench.rng))
    performers: dict[Verb, Callable[[], float]] = {
        "pick up": lambda: pick_up(bench, hand, option.part, t_s),
        "put down": lambda: put_down(bench, hand, t_s),
        "position": lambda: position(bench, t_s),
        "remove": lambda: remove(bench, option.part, t_s),
    }
    return performers[option.verb]()


def _num_strokes(rng: np.random.Generator) -> int:
    """A long tail: most screws take 3 to 6 strokes, some 12."""
    return int(np.clip(np.round(rng.lognormal(np.log(4.0), 0.45)), 2, 12))


def _pause(bench: Bench, t_s: float) -> float:
    """Wait a little, sometimes long, with the free hand at rest; sometimes set the workpiece aside."""
    rng = bench.rng
    if bench.worker not in bench.held and rng.random() < _AWAY_CHANCE:
        return _go_away(bench, bench.worker, t_s)
    held = bench.held.get(bench.holder)
    if held is not None and rng.random() < _SET_ASIDE_CHANCE:
        bench.leave_frame(bench.worker, t_s)
        return put_down(bench, bench.holder, t_s)
    return t_s + float(min(rng.lognormal(np.log(0.12), 1.0), 2.0))


def _go_away(bench: Bench, hand: Hand, t_s: float) -> float:
    """Lead the hand to the headset or the edge of the table, stay there, and come back above the table."""
    rng = bench.rng
    bench.leave_frame(hand, t_s)
    goal = _beside_headset(hand) if rng.random() < 0.5 else _resting(hand, rng)
    there_s = travel(bench, hand, free_key(t_s + 0.6, goal))
    return bench.wait(hand, there_s + float(rng.uniform(0.4, 1.8)))


def _resting(hand: Hand, rng: np.random.Generator) -> Rigid:
    """Palm down near the edge of the table."""
    side = SIDE[hand]
    y = np.array([0.86, 0.05, -0.30 * side])
    y /= np.linalg.norm(y)
    z = np.array([0.0, 1.0, 0.0]) - y * y[1]
    z /= np.linalg.norm(z)
    spot = np.array([rng.uniform(-160.0, -120.0), TABLE_TOP_Y_MM + 88.0, 80.0 + side * rng.uniform(190.0, 250.0)])
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), spot)


def _beside_headset(hand: Hand) -> Rigid:
    """Fingertips at the side of the headset, as if to set it right."""
    side = SIDE[hand]
    y = np.array([0.05, 0.95, -0.30 * side])
    y /= np.linalg.norm(y)
    palm = np.array([0.15, 0.0, -1.0 * side])
    z = -(palm - y * (palm @ y))
    z /= np.linalg.norm(z)
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), np.array([-165.0, 330.0, 80.0 + side * 165.0]))


def _lay_out(bench: Bench, is_building: bool) -> None:
    """Mount some parts, spread the others over the table, and place both hands."""
    rng, parts = bench.rng, bench.parts
    for hand in (bench.worker, bench.holder):
        bench.hand_keys[hand].append(free_key(0.0, _resting(hand, rng)))
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
    on_holders_side = part.mount is None and not is_workpiece and rng.random() < 0.3
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
