"""Scripts of takes: which verb comes next, for whom and how long, drawn from what is possible on the bench.

Designed frequencies (share of choices, if all actions took equally long): pick up 0.35, put down 0.20, position 0.18,
remove 0.09, screw 0.09, unscrew 0.09. Screw and unscrew last some seconds, the others one or two, so that in takes of
40 s they are 0.06 and 0.04 of the segments. What is taken is put somewhere: pick up + remove = position + put down.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import Bench, Verb, free_key
from assemblyhands_core.synthetic.clearance import travel
from assemblyhands_core.synthetic.layout import beside_headset, lay_out, resting
from assemblyhands_core.synthetic.moves import pick_up, position, put_down, remove
from assemblyhands_core.synthetic.objects import PartSet
from assemblyhands_core.synthetic.person import SIDE, Subject
from assemblyhands_core.synthetic.rig import WORK_CENTER_WORLD_MM
from assemblyhands_core.synthetic.turning import turn_screw

VERBS: Final[tuple[Verb, ...]] = ("pick up", "position", "put down", "remove", "screw", "unscrew")
"""The frequent ones first."""

_AWAY_CHANCE: Final = 0.05
_SET_ASIDE_CHANCE: Final = 0.05
_CHANGE_OF_MIND: Final = 0.06
_BUILDING_SHARE: Final = 0.62
_TEMPO_SPREAD: Final = 0.18


class Option(NamedTuple):
    """Something that can be done next."""

    verb: Verb
    part: str
    hand: Hand
    weight: float


def write_script(subject: Subject, parts: PartSet, rng: np.random.Generator, duration_s: float) -> Bench:
    """Script a take from an instant in the middle of some work to at least its end.

    Args:
        subject: Who works.
        parts: What with.
        rng: Decides on everything; same state, same script.
        duration_s: Until when there has to be a script.
    """
    bench = Bench(subject, parts, rng, tempo=1.0)
    mean_tempo = float(rng.uniform(0.85, 1.25))
    is_building = bool(rng.random() < _BUILDING_SHARE)
    lay_out(bench, is_building)
    t_s, last_part = float(rng.uniform(0.0, 0.4)), ""
    while t_s < duration_s:
        choices = options(bench, is_building)
        if not _has_use(choices) or rng.random() < _CHANGE_OF_MIND:
            is_building = not is_building
            choices = options(bench, is_building)
        bench.tempo = mean_tempo * float(rng.lognormal(0.0, _TEMPO_SPREAD))
        choice = _drawn([_less_if_last(option, last_part) for option in choices], rng)
        t_s, last_part = _pause(bench, _perform(bench, choice, t_s)), choice.part
    return bench


def options(bench: Bench, is_building: bool) -> list[Option]:
    """Return what can be done next, with weights; there is always something.

    Args:
        bench: State.
        is_building: Whether the toy is being put together or taken apart.
    """
    workpiece, holder, worker = bench.parts.workpiece, bench.holder, bench.worker
    if holder not in bench.held:
        aside = [o for o in _picking(bench, is_building) if _is_on_side(bench, o.part, holder)]
        sorting = [o._replace(hand=holder, weight=0.3) for o in aside]
        return [Option("pick up", workpiece, holder, 1.0), *sorting]
    if bench.held[holder].part != workpiece:
        return [Option("put down", bench.held[holder].part, holder, 1.0)]
    held = bench.held.get(worker)
    if held is None:
        picking = [o for o in _picking(bench, is_building) if not _is_on_side(bench, o.part, holder)]
        return [*picking, *_removing(bench, is_building), *_turning(bench, is_building, by_tool=False)]
    put_down_option = Option("put down", held.part, worker, _PUT_DOWN_WEIGHT[is_building])
    if held.part == bench.parts.tool:
        turning = _turning(bench, is_building, by_tool=True)
        return [*turning, put_down_option._replace(weight=0.2 if _has_use(turning) else 5.0)]
    if _can_be_mounted(bench, held.part):
        return [Option("position", held.part, worker, _POSITION_WEIGHT[is_building]), put_down_option]
    return [put_down_option]


# By whether the toy is being put together. Together with the chances above they make the designed frequencies.
_PUT_DOWN_WEIGHT: Final = {True: 0.5, False: 5.0}
_POSITION_WEIGHT: Final = {True: 5.0, False: 0.5}
_PICK_WEIGHT: Final = {True: 1.5, False: 0.12}
_REMOVE_WEIGHT: Final = {True: 0.12, False: 2.5}
_USELESS: Final = 0.12
_TOOL_WEIGHT: Final = 2.5
_SCREW_WEIGHT: Final = 1.6
_UNSCREW_WEIGHT: Final = 0.25
_BY_TOOL: Final = 4.0


def _picking(bench: Bench, is_building: bool) -> list[Option]:
    """Parts to take from the table, and the tool where there is something to turn."""
    found = []
    num_turned = sum(option.weight >= _USELESS for option in _turning(bench, is_building, by_tool=True))
    for name in bench.parts.parts:
        if not bench.is_on_table(name) or bench.mounted_children(name) or name == bench.parts.workpiece:
            continue
        if name == bench.parts.tool:
            found.append(Option("pick up", name, bench.worker, _TOOL_WEIGHT * min(num_turned, 2)))
        else:
            useful = is_building and _can_be_mounted(bench, name)
            found.append(Option("pick up", name, bench.worker, _PICK_WEIGHT[True] if useful else _PICK_WEIGHT[False]))
    return [option for option in found if option.weight > 0]


def _removing(bench: Bench, is_building: bool) -> list[Option]:
    """Parts to take off the toy."""
    loose = [name for name in bench.parts.parts if bench.is_loose(name) and not bench.mounted_children(name)]
    return [Option("remove", name, bench.worker, _REMOVE_WEIGHT[is_building]) for name in loose]


def _turning(bench: Bench, is_building: bool, by_tool: bool) -> list[Option]:
    """Screws to turn in or out."""
    found, factor = [], _BY_TOOL if by_tool else 1.0
    for name, part in bench.parts.parts.items():
        if part.mount is None or part.mount.travel_mm == 0 or name not in bench.mounted:
            continue
        if bench.is_loose(name):
            weight = factor * _SCREW_WEIGHT * (1.0 if is_building else 0.02)
            found.append(Option("screw", name, bench.worker, weight))
        else:
            weight = factor * _UNSCREW_WEIGHT * (0.02 if is_building else 1.0)
            found.append(Option("unscrew", name, bench.worker, weight))
    return found


def _has_use(choices: list[Option]) -> bool:
    """Tell whether anything but idle play can be done."""
    return any(option.weight > _USELESS for option in choices)


def _is_on_side(bench: Bench, name: str, hand: Hand) -> bool:
    """Tell whether a part on the table lies on the side of a hand."""
    place = bench.part_keys[name][-1].T_carrier_from_part[:3, 3]
    return bool((place[2] - WORK_CENTER_WORLD_MM[2]) * SIDE[hand] > 0)


def _can_be_mounted(bench: Bench, name: str) -> bool:
    """Tell whether what a part belongs on is there: held, or mounted on what is held, or standing on the table."""
    mount = bench.part(name).mount
    if mount is None:
        return False
    root = bench.parts.root(name)
    held = bench.held.get(bench.holder)
    is_held = held is not None and held.part == root
    is_at_hand = root != bench.parts.workpiece and bench.is_on_table(root) and _is_on_side(bench, root, bench.worker)
    return (is_held or is_at_hand) and (mount.parent in bench.mounted or mount.parent == root)


def _less_if_last(option: Option, last_part: str) -> Option:
    """What was handled just now is rarely handled again, unless it is to be turned, put down or put on."""
    again = option.part == last_part and option.verb in ("pick up", "remove")
    return option._replace(weight=0.1 * option.weight) if again else option


def _drawn(choices: list[Option], rng: np.random.Generator) -> Option:
    weights = np.array([option.weight for option in choices])
    return choices[int(rng.choice(len(choices), p=weights / weights.sum()))]


def _perform(bench: Bench, option: Option, t_s: float) -> float:
    """Script one action; returns when the hand is free."""
    performers: dict[Verb, Callable[[], float]] = {
        "pick up": lambda: pick_up(bench, option.hand, option.part, t_s),
        "put down": lambda: put_down(bench, option.hand, t_s),
        "position": lambda: position(bench, t_s),
        "remove": lambda: remove(bench, option.part, t_s),
        "screw": lambda: turn_screw(bench, option.part, t_s, _num_strokes(bench.rng)),
        "unscrew": lambda: turn_screw(bench, option.part, t_s, _num_strokes(bench.rng)),
    }
    return performers[option.verb]()


def _num_strokes(rng: np.random.Generator) -> int:
    """A long tail: most screws take 3 to 6 strokes, some 12."""
    return int(np.clip(np.round(rng.lognormal(np.log(4.0), 0.45)), 2, 12))


def _pause(bench: Bench, t_s: float) -> float:
    """Wait a little, sometimes long, with the free hand at rest; sometimes set the workpiece aside."""
    rng = bench.rng
    is_busy = bench.worker in bench.held
    if not is_busy and rng.random() < _AWAY_CHANCE:
        return _go_away(bench, bench.worker, t_s)
    if not is_busy and bench.holder in bench.held and rng.random() < _SET_ASIDE_CHANCE:
        there_s = _go_to_rest(bench, bench.worker, t_s)
        return put_down(bench, bench.holder, 0.5 * (t_s + there_s))
    return t_s + float(min(rng.lognormal(np.log(0.12), 1.0), 2.0))


def _go_away(bench: Bench, hand: Hand, t_s: float) -> float:
    """Lead the hand to the headset or the edge of the table and stay there."""
    rng = bench.rng
    if rng.random() < 0.5:
        there_s = _go_to_rest(bench, hand, t_s)
    else:
        bench.leave_frame(hand, t_s)
        there_s = travel(bench, hand, free_key(t_s + 0.6, beside_headset(hand)))
    return bench.wait(hand, there_s + float(rng.uniform(0.4, 1.8)))


def _go_to_rest(bench: Bench, hand: Hand, t_s: float) -> float:
    bench.leave_frame(hand, t_s)
    return travel(bench, hand, free_key(t_s + 0.5, resting(hand, bench.rng)))
