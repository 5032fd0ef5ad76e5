"""The six verbs as keys of hands and parts. Every move starts and ends at rest and returns when it ends, in s.

A hand reaches from a distance with open fingers, closes them at rest, and lets go the same way. What is gripped in one
way and used in another is turned in the fingers on the way.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.hands.kinematics import clamp_to_limits
from assemblyhands_core.synthetic.bench import Bench, Held, Rigid, gripped
from assemblyhands_core.synthetic.grips import HandGrip
from assemblyhands_core.synthetic.motion import WORLD, HandKey, about_z, rotation, rotation_vector, shifted
from assemblyhands_core.synthetic.placing import TILTS_RAD, best_grip, best_presentation, best_spot

_BACK_OFF_MM: Final = 50.0
_OUT_MM: Final = 42.0
_LABEL_START: Final = 0.45
"""Share of a reach or transport after which its action has begun, as annotators see it."""
_REGRIP_COST: Final = 0.6


def pick_up(bench: Bench, hand: Hand, name: str, t_s: float) -> float:
    """Take a part from the table and lift it."""
    part, start_s = bench.part(name), bench.wait(hand, t_s)
    grip = bench.grip(part.pick, hand)
    T_world_from_part = bench.at(start_s).T_world_from(name)
    candidates = gripped(part.pick, TILTS_RAD)
    T_part_from_grip = candidates[best_grip(bench, hand, grip, T_world_from_part, candidates)]
    T_world_from_grip = T_world_from_part @ T_part_from_grip
    near_s, closed_s = _reach(bench, hand, WORLD, T_world_from_grip, grip)
    _take(bench, hand, Held(name, T_part_from_grip, grip), closed_s)
    end_s = _lift(bench, hand, T_world_from_grip, grip)
    bench.label("pick up", name, hand, start_s + _LABEL_START * (near_s - start_s), end_s)
    return end_s


def put_down(bench: Bench, hand: Hand, t_s: float) -> float:
    """Put what a hand holds on a free spot of the table."""
    held, start_s = bench.held[hand], bench.wait(hand, t_s)
    part = bench.part(held.part)
    is_regripped = part.work is not None
    grips = gripped(part.pick, TILTS_RAD) if is_regripped else held.T_part_from_grip[None]
    grip = bench.grip(part.pick, hand)
    T_world_from_part, index = best_spot(bench, hand, grip, grips, part.name)
    T_world_from_grip = T_world_from_part @ grips[index]
    above = transforms.rigid(T_world_from_grip[:3, :3], T_world_from_grip[:3, 3] + (0.0, _BACK_OFF_MM, 0.0))
    near_s = bench.move(hand, _key(start_s, WORLD, above, grip, arc_mm=20.0))
    _turn_in_fingers(bench, hand, Held(part.name, grips[index], grip), start_s, near_s)
    down_s = bench.move(hand, _key(near_s + 0.3 * bench.tempo, WORLD, T_world_from_grip, grip, tremor=0.0))
    bench.carry(part.name, WORLD, T_world_from_part, down_s)
    del bench.held[hand]
    open_s, end_s = _let_go(bench, hand, WORLD, T_world_from_grip, grip)
    bench.label("put down", part.name, hand, start_s + _LABEL_START * (near_s - start_s), open_s)
    return end_s


def position(bench: Bench, t_s: float) -> float:
    """Put what the working hand holds where it belongs."""
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    held = bench.held[hand]
    part, root = bench.part(held.part), bench.parts.root(held.part)
    grip = bench.grip(part.working_grip, hand)
    mount = part.mount
    if mount is None:
        raise ValueError(f"Part {part.name} has no mount, so that it cannot be positioned: put it down.")
    grips = gripped(part.work, TILTS_RAD) if part.work else held.T_part_from_grip[None]
    turns = [2 * np.pi * i / mount.num_turns for i in range(mount.num_turns)]
    T_root_from_parent = _from_root(bench, root, mount.parent, start_s)
    places = [T_root_from_parent @ bench.T_parent_from_mounted(part.name, turn, mount.travel_mm) for turn in turns]
    candidates = np.stack([place @ T for place in places for T in grips])[:, None]
    regrip = np.tile(_regrip_cost(held, grips, grip), len(turns))
    choice = best_presentation(bench, grip, root, start_s, candidates, (part.name,), regrip)
    presented_s = _present(bench, root, choice.T_world_from_root, start_s)
    place, T_part_from_grip = places[choice.index // len(grips)], grips[choice.index % len(grips)]
    near = place @ shifted(z_mm=_OUT_MM) @ T_part_from_grip
    near_s = bench.move(hand, _key(max(start_s, presented_s - 0.1), root, near, grip, arc_mm=15.0))
    _turn_in_fingers(bench, hand, Held(part.name, T_part_from_grip, grip), start_s, near_s)
    _wiggle(bench, hand, root, place @ shifted(z_mm=0.25 * _OUT_MM), T_part_from_grip, grip)
    there_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.25, 0.6)
    there_s = bench.move(hand, _key(there_s, root, place @ T_part_from_grip, grip, tremor=0.0))
    bench.mounted[part.name] = (turns[choice.index // len(grips)], mount.travel_mm)
    bench.carry(part.name, mount.parent, bench.T_parent_from_mounted(part.name, *bench.mounted[part.name]), there_s)
    del bench.held[hand]
    open_s, end_s = _let_go(bench, hand, root, place @ T_part_from_grip, grip)
    bench.label("position", part.name, hand, start_s + _LABEL_START * (near_s - start_s), open_s)
    return end_s


def remove(bench: Bench, name: str, t_s: float) -> float:
    """Take a loose part off its mount."""
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    part, root = bench.part(name), bench.parts.root(name)
    grip, grips = bench.grip(part.working_grip, hand), gripped(part.working_grip, TILTS_RAD)
    place = _from_root(bench, root, name, start_s)
    choice = best_presentation(bench, grip, root, start_s, (place @ grips)[:, None], (name,))
    presented_s = _present(bench, root, choice.T_world_from_root, start_s)
    T_part_from_grip = grips[choice.index]
    near_s, closed_s = _reach(bench, hand, root, place @ T_part_from_grip, grip, presented_s)
    _take(bench, hand, Held(name, T_part_from_grip, grip), closed_s)
    del bench.mounted[name]
    _wiggle(bench, hand, root, place @ shifted(z_mm=2.0), T_part_from_grip, grip)
    out = place @ shifted(z_mm=_OUT_MM) @ T_part_from_grip
    out_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.3, 0.6)
    out_s = bench.move(hand, _key(out_s, root, out, grip))
    bench.label("remove", name, hand, start_s + _LABEL_START * (near_s - start_s), out_s)
    return _lift(bench, hand, bench.at(out_s).T_world_from(root) @ out, grip)


def turn_screw(bench: Bench, name: str, t_s: float, num_strokes: int) -> float:
    """Screw a loose part in, or a tight one out: stroke, open the fingers, turn back, close.

    The hand of a right-handed thread turns clockwise, seen from outside, to screw in. With a tool in the hand the tool
    is used, without the fingers.
    """
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    is_in = not bench.is_tight(name)
    turning = _Turning(bench, name, num_strokes, -1.0 if is_in else 1.0, start_s)
    held = bench.held.get(hand)
    grips = gripped(turning.grip_of_part, TILTS_RAD)
    ends = np.stack([turning.hand(share, 0.0) @ grips for share in (-0.5, 0.5)], axis=1)
    regrip = 0.0 if held is None else _regrip_cost(held, grips, turning.grip)
    ignored = (name,) if held is None else (name, held.part)
    choice = best_presentation(bench, turning.grip, turning.root, start_s, ends, ignored, regrip)
    presented_s = _present(bench, turning.root, choice.T_world_from_root, start_s)
    chosen = grips[choice.index]
    near_s = turning.begin(held, chosen, presented_s)
    for stroke in range(num_strokes):
        turning.stroke(chosen, stroke, stroke == num_strokes - 1)
    end_s = bench.end_s(hand)
    bench.label("screw" if is_in else "unscrew", name, hand, start_s + 0.7 * (near_s - start_s), end_s)
    return turning.end(held, chosen)


class _Turning:
    """One screw being turned; the hand's poses are in the frame of the workpiece."""

    def __init__(self, bench: Bench, name: str, num_strokes: int, sense: float, t_s: float) -> None:
        self.bench, self.name, self.num_strokes, self.sense = bench, name, num_strokes, sense
        self.worker: Hand = bench.worker
        part, self.root = bench.part(name), bench.parts.root(name)
        if part.mount is None:
            raise ValueError(f"Part {name} has no mount, so that it cannot be turned: give it one.")
        self.mount = part.mount
        self.turn_rad, self.out_mm = bench.mounted[name]
        self.goal_mm = 0.0 if sense < 0 else self.mount.travel_mm
        held = bench.held.get(bench.worker)
        self.grip_of_part = part.working_grip if held is None else bench.part(held.part).working_grip
        self.grip = bench.grip(self.grip_of_part, bench.worker)
        self.tip = np.eye(4) if held is None else shifted(z_mm=_head_mm(bench, name))
        self.stroke_rad = float(bench.rng.uniform(1.0, 1.5) if held is None else bench.rng.uniform(1.2, 1.8))
        self.stroke_s = float(bench.rng.uniform(0.34, 0.5)) * bench.tempo
        self.T_root_from_parent = _from_root(bench, self.root, self.mount.parent, t_s)

    def part(self, strokes: float) -> Rigid:
        """The screw on its mount after a number of strokes."""
        out = self.out_mm + (self.goal_mm - self.out_mm) * strokes / self.num_strokes
        return self.bench.T_parent_from_mounted(self.name, self.turn_rad + self.sense * self.stroke_rad * strokes, out)

    def hand(self, share: float, strokes: float) -> Rigid:
        """Where the gripped thing would be if it turned with the hand, a share (-0.5 to 0.5) through its stroke."""
        out = self.out_mm + (self.goal_mm - self.out_mm) * strokes / self.num_strokes
        turn = self.turn_rad + self.sense * self.stroke_rad * share
        return np.asarray(self.T_root_from_parent @ self.bench.T_parent_from_mounted(self.name, turn, out) @ self.tip)

    def rolled(self, share: float) -> Float64[np.ndarray, "20"]:
        """The fingers of the closed grip, rolling against the thumb through a stroke."""
        way = share * self.sense * (1.0 if self.worker == "right" else -1.0)
        return clamp_to_limits(self.grip.closed_rad + way * _ROLL_RAD)

    def begin(self, held: Held | None, chosen: Rigid, presented_s: float) -> float:
        """Bring fingers or tool to the screw; returns when the hand is near."""
        bench, start = self.bench, self.hand(-0.5, 0.0) @ chosen
        if held is None:
            near_s, _ = _reach(bench, self.worker, self.root, start, self.grip, presented_s)
            return near_s
        start_s = bench.end_s(self.worker)
        back = self.hand(-0.5, 0.0) @ shifted(z_mm=_OUT_MM) @ chosen
        near_s = bench.move(self.worker, _key(presented_s - 0.1, self.root, back, self.grip, arc_mm=15.0))
        _turn_in_fingers(bench, self.worker, Held(held.part, chosen, self.grip), start_s, near_s)
        there_s = bench.move(self.worker, _key(near_s + 0.35 * bench.tempo, self.root, start, self.grip, tremor=0.0))
        at_tip = transforms.inverse(self.T_root_from_parent @ self.part(0.0)) @ self.hand(-0.5, 0.0)
        bench.carry(held.part, self.name, at_tip, there_s)
        return near_s

    def stroke(self, chosen: Rigid, index: int, is_last: bool) -> None:
        """One turn of the screw and, but for the last one, the way back with open fingers."""
        bench, worker = self.bench, self.worker
        start, end = self.hand(-0.5, index) @ chosen, self.hand(0.5, index + 1.0) @ chosen
        start_s = bench.move(worker, self._key(bench.end_s(worker) + 0.06, start, self.rolled(-0.5)))
        bench.carry(self.name, self.mount.parent, self.part(index), start_s)
        end_s = bench.move(worker, self._key(start_s + self.stroke_s, end, self.rolled(0.5)))
        bench.carry(self.name, self.mount.parent, self.part(index + 1.0), end_s)
        if is_last:
            return
        ajar = self.grip.closed_rad + 0.6 * (self.grip.open_rad - self.grip.closed_rad)
        back = self.hand(-0.5, index + 1.0) @ chosen
        open_s = bench.move(worker, self._key(end_s + 0.09, end, ajar))
        back_s = bench.move(worker, self._key(open_s + 0.75 * self.stroke_s, back, ajar))
        bench.move(worker, self._key(back_s + 0.09, back, self.rolled(-0.5)))

    def end(self, held: Held | None, chosen: Rigid) -> float:
        """Leave the screw where it is now."""
        bench, end = self.bench, self.hand(0.5, float(self.num_strokes)) @ chosen
        turn = self.turn_rad + self.sense * self.stroke_rad * self.num_strokes
        bench.mounted[self.name] = (turn, self.goal_mm)
        end_s = bench.end_s(self.worker)
        if held is None:
            return _let_go(bench, self.worker, self.root, end, self.grip)[1]
        now = bench.at(end_s)
        T_tool_from_grip = transforms.inverse(now.T_world_from(held.part)) @ now.T_world_from(self.root) @ end
        _take(bench, self.worker, Held(held.part, T_tool_from_grip, self.grip), end_s)
        back = self.hand(0.5, float(self.num_strokes)) @ shifted(z_mm=_OUT_MM) @ chosen
        return bench.move(self.worker, _key(end_s + 0.3 * bench.tempo, self.root, back, self.grip))

    def _key(self, t_s: float, T_root_from_grip: Rigid, angles_rad: Float64[np.ndarray, "20"]) -> HandKey:
        wrist = self.grip.T_wrist_from_grip
        return HandKey(t_s, self.root, T_root_from_grip, wrist, angles_rad, tremor=0.0)


# Per rad of share: thumb one way, index and middle finger the other (order of `kinematics.ANGLE_NAMES`).
_ROLL_RAD: Final = np.zeros(20)
_ROLL_RAD[[1, 2, 5, 6, 9, 10]] = (0.16, 0.10, -0.16, -0.10, -0.12, -0.08)
_ROLL_RAD.flags.writeable = False


def _head_mm(bench: Bench, name: str) -> float:
    """Where the tip of a tool sits in the head of a screw."""
    return float(bench.part(name).vertices_mm[:, 2].max()) - 2.0


def _key(
    t_s: float,
    frame: str,
    T_frame_from_grip: Rigid,
    grip: HandGrip,
    is_open: bool = False,
    arc_mm: float = 0.0,
    tremor: float = 1.0,
) -> HandKey:
    angles = grip.open_rad if is_open else grip.closed_rad
    return HandKey(t_s, frame, T_frame_from_grip, grip.T_wrist_from_grip, angles, arc_mm, tremor)


def _reach(
    bench: Bench, hand: Hand, frame: str, T_frame_from_grip: Rigid, grip: HandGrip, earliest_s: float = 0.0
) -> tuple[float, float]:
    """Reach with open fingers and close them; returns when the hand is near and when it is closed."""
    back = T_frame_from_grip @ shifted(z_mm=-_BACK_OFF_MM)
    start_s = max(bench.end_s(hand) + 0.3, earliest_s - 0.1)
    near_s = bench.move(hand, _key(start_s, frame, back, grip, True, arc_mm=float(bench.rng.uniform(10.0, 35.0))))
    there_s = bench.move(hand, _key(near_s + 0.22 * bench.tempo, frame, T_frame_from_grip, grip, True, tremor=0.0))
    closed_s = there_s + bench.tempo * bench.rng.uniform(0.14, 0.22)
    return near_s, bench.move(hand, _key(closed_s, frame, T_frame_from_grip, grip, tremor=0.0))


def _let_go(bench: Bench, hand: Hand, frame: str, T_frame_from_grip: Rigid, grip: HandGrip) -> tuple[float, float]:
    """Open the fingers and draw the hand back; returns when it is open and when it is away."""
    open_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.14, 0.22)
    open_s = bench.move(hand, _key(open_s, frame, T_frame_from_grip, grip, True, tremor=0.0))
    back = T_frame_from_grip @ shifted(z_mm=-_BACK_OFF_MM)
    return open_s, bench.move(hand, _key(open_s + 0.25 * bench.tempo, frame, back, grip, True))


def _lift(bench: Bench, hand: Hand, T_world_from_grip: Rigid, grip: HandGrip) -> float:
    """Bring what was taken up and a little towards the middle."""
    rng = bench.rng
    lifted = T_world_from_grip.copy()
    to_middle = np.array([50.0, 120.0, 80.0]) - lifted[:3, 3]
    lifted[:3, 3] += to_middle * (rng.uniform(0.15, 0.35), 0.0, rng.uniform(0.15, 0.35))
    lifted[1, 3] = max(lifted[1, 3], rng.uniform(70.0, 120.0))
    lifted[:3, :3] = rotation(rng.normal(0.0, 0.12, 3)) @ lifted[:3, :3]
    return bench.move(hand, _key(bench.end_s(hand) + 0.3 * bench.tempo, WORLD, lifted, grip))


def _wiggle(bench: Bench, hand: Hand, frame: str, place: Rigid, T_part_from_grip: Rigid, grip: HandGrip) -> None:
    """Turn a part to and fro a little, as one does to fit it in or to loosen it."""
    angle = bench.rng.uniform(0.06, 0.16)
    for turn in (angle, -angle) if bench.rng.random() < 0.6 else (angle,):
        t_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.16, 0.26)
        bench.move(hand, _key(t_s, frame, place @ about_z(turn) @ T_part_from_grip, grip))


def _take(bench: Bench, hand: Hand, held: Held, t_s: float) -> None:
    bench.held[hand] = held
    bench.carry(held.part, hand, held.T_wrist_from_part, t_s)


def _turn_in_fingers(bench: Bench, hand: Hand, held: Held, start_s: float, end_s: float) -> None:
    """Change over to another grip of what is held, while the hand moves."""
    bench.carry(held.part, hand, bench.held[hand].T_wrist_from_part, start_s)
    _take(bench, hand, held, end_s)


def _regrip_cost(held: Held, grips: Float64[np.ndarray, "n 4 4"], grip: HandGrip) -> Float64[np.ndarray, " n"]:
    """How far the held part would have to be turned in the fingers for each grip."""
    start = held.T_wrist_from_part[:3, :3]
    ends: Sequence[Rigid] = [Held(held.part, T, grip).T_wrist_from_part for T in grips]
    turns = [float(np.linalg.norm(rotation_vector(start.T @ end[:3, :3]))) for end in ends]
    return _REGRIP_COST * np.array(turns)


def _from_root(bench: Bench, root: str, name: str, t_s: float) -> Rigid:
    """Where a part is in the frame of what it is mounted on in the end."""
    now = bench.at(t_s)
    return np.asarray(transforms.inverse(now.T_world_from(root)) @ now.T_world_from(name))


def _present(bench: Bench, root: str, T_world_from_root: Rigid, t_s: float) -> float:
    """Let the holding hand bring the workpiece to where it is worked on; returns when it is there."""
    hand = bench.holder
    held = bench.held.get(hand)
    if held is None or held.part != root:
        return t_s
    bench.wait(hand, t_s)
    return bench.move(hand, _key(t_s, WORLD, T_world_from_root @ held.T_part_from_grip, held.grip))
