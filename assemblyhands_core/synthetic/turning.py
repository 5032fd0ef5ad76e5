"""Screwing and unscrewing, by fingers or with the screwdriver: cycles of strokes."""

from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.hands.kinematics import clamp_to_limits
from assemblyhands_core.synthetic.bench import Bench, Held, Rigid
from assemblyhands_core.synthetic.clearance import travel
from assemblyhands_core.synthetic.handling import (
    OUT_MM,
    from_root,
    hand_key,
    let_go,
    present,
    reach,
    regrip_cost,
    take,
    turn_in_fingers,
)
from assemblyhands_core.synthetic.motion import HandKey, shifted
from assemblyhands_core.synthetic.presenting import best_presentation


def turn_screw(bench: Bench, name: str, t_s: float, num_strokes: int) -> float:
    """Screw a loose part in, or a tight one out: stroke, open the fingers, turn back, close.

    The hand turns clockwise, seen from outside, to screw in (right-handed thread). With a tool in the hand the tool is
    used, without one the fingers.
    """
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    is_in = not bench.is_tight(name)
    turning = _Turning(bench, name, num_strokes, -1.0 if is_in else 1.0, start_s)
    held = bench.held.get(hand)
    turned = name if held is None else held.part
    ways = bench.ways(turned, bench.part(turned).working_grip, hand)
    places = np.stack([turning.hand(share, 0.0) for share in (-0.5, 0.5)])[None]
    regrip = 0.0 if held is None else regrip_cost(held, ways)
    choice = best_presentation(bench, ways, turning.root, start_s, places, (name, turned), regrip)
    presented_s = present(bench, turning.root, choice.T_world_from_root, start_s)
    chosen = ways.held(turned, choice.way)
    near_s = turning.begin(chosen, presented_s)
    for stroke in range(num_strokes):
        turning.stroke(chosen, stroke, stroke == num_strokes - 1)
    bench.label("screw" if is_in else "unscrew", name, hand, start_s + 0.7 * (near_s - start_s), bench.end_s(hand))
    return turning.end(chosen)


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
        self.is_by_tool = held is not None
        self.tip = np.eye(4) if held is None else shifted(z_mm=_head_mm(bench, name))
        self.stroke_rad = float(bench.rng.uniform(1.0, 1.5) if held is None else bench.rng.uniform(1.2, 1.8))
        self.stroke_s = float(bench.rng.uniform(0.34, 0.5)) * bench.tempo
        self.T_root_from_parent = from_root(bench, self.root, self.mount.parent, t_s)

    def part(self, strokes: float) -> Rigid:
        """The screw on its mount after a number of strokes."""
        out = self.out_mm + (self.goal_mm - self.out_mm) * strokes / self.num_strokes
        return self.bench.T_parent_from_mounted(self.name, self.turn_rad + self.sense * self.stroke_rad * strokes, out)

    def hand(self, share: float, strokes: float) -> Rigid:
        """Where the gripped thing would be if it turned with the hand, a share (-0.5 to 0.5) through its stroke."""
        out = self.out_mm + (self.goal_mm - self.out_mm) * strokes / self.num_strokes
        turn = self.turn_rad + self.sense * self.stroke_rad * share
        return np.asarray(self.T_root_from_parent @ self.bench.T_parent_from_mounted(self.name, turn, out) @ self.tip)

    def rolled(self, chosen: Held, share: float) -> Float64[np.ndarray, "20"]:
        """The fingers of the closed grip, rolling against the thumb through a stroke."""
        way = share * self.sense * (1.0 if self.worker == "right" else -1.0)
        return clamp_to_limits(chosen.grip.closed_rad + way * _ROLL_RAD)

    def begin(self, chosen: Held, presented_s: float) -> float:
        """Bring fingers or tool to the screw; returns when the hand is near."""
        bench, worker, start = self.bench, self.worker, self.hand(-0.5, 0.0)
        if not self.is_by_tool:
            near_s, _ = reach(bench, worker, self.root, start @ chosen.T_part_from_grip, chosen.grip, presented_s)
            return near_s
        start_s = bench.end_s(worker)
        back = start @ shifted(z_mm=OUT_MM) @ chosen.T_part_from_grip
        near_s = travel(bench, worker, hand_key(presented_s - 0.1, self.root, back, chosen.grip, lift_mm=15.0))
        turn_in_fingers(bench, worker, chosen, start_s, near_s)
        down = hand_key(
            near_s + 0.35 * bench.tempo, self.root, start @ chosen.T_part_from_grip, chosen.grip, tremor=0.0
        )
        there_s = bench.move(worker, down)
        at_tip = transforms.inverse(self.T_root_from_parent @ self.part(0.0)) @ start
        bench.carry(chosen.part, self.name, at_tip, there_s)
        return near_s

    def stroke(self, chosen: Held, index: int, is_last: bool) -> None:
        """One turn of the screw and, but for the last one, the way back with open fingers."""
        bench, grip = self.bench, chosen.grip
        start_s = self._move(chosen, -0.5, index, self.rolled(chosen, -0.5), 0.06)
        bench.carry(self.name, self.mount.parent, self.part(index), start_s)
        end_s = self._move(chosen, 0.5, index + 1.0, self.rolled(chosen, 0.5), self.stroke_s)
        bench.carry(self.name, self.mount.parent, self.part(index + 1.0), end_s)
        if is_last:
            return
        ajar = grip.closed_rad + 0.6 * (grip.open_rad - grip.closed_rad)
        self._move(chosen, 0.5, index + 1.0, ajar, 0.09)
        self._move(chosen, -0.5, index + 1.0, ajar, 0.75 * self.stroke_s)
        self._move(chosen, -0.5, index + 1.0, self.rolled(chosen, -0.5), 0.09)

    def end(self, chosen: Held) -> float:
        """Leave the screw where it is now."""
        bench, there = self.bench, self.hand(0.5, float(self.num_strokes))
        turn = self.turn_rad + self.sense * self.stroke_rad * self.num_strokes
        bench.mounted[self.name] = (turn, self.goal_mm)
        end_s, end = bench.end_s(self.worker), there @ chosen.T_part_from_grip
        if not self.is_by_tool:
            return let_go(bench, self.worker, self.root, end, chosen.grip)[1]
        now = bench.at(end_s)
        T_tool_from_grip = transforms.inverse(now.T_world_from(chosen.part)) @ now.T_world_from(self.root) @ end
        take(bench, self.worker, Held(chosen.part, T_tool_from_grip, chosen.grip), end_s)
        back = there @ shifted(z_mm=OUT_MM) @ chosen.T_part_from_grip
        return bench.move(self.worker, hand_key(end_s + 0.3 * bench.tempo, self.root, back, chosen.grip))

    def _move(
        self, chosen: Held, share: float, strokes: float, angles_rad: Float64[np.ndarray, "20"], lasting_s: float
    ) -> float:
        """Bring the hand to a share of its stroke; returns when it is there."""
        T_root_from_grip = self.hand(share, strokes) @ chosen.T_part_from_grip
        wrist, t_s = chosen.grip.T_wrist_from_grip, self.bench.end_s(self.worker) + lasting_s
        key = HandKey(t_s, self.root, T_root_from_grip, wrist, angles_rad, tremor=0.0)
        return self.bench.move(self.worker, key)


# Per rad of share: thumb one way, index and middle finger the other (order of `kinematics.ANGLE_NAMES`).
_ROLL_RAD: Final = np.zeros(20)
_ROLL_RAD[[1, 2, 5, 6, 9, 10]] = (0.16, 0.10, -0.16, -0.10, -0.12, -0.08)
_ROLL_RAD.flags.writeable = False


def _head_mm(bench: Bench, name: str) -> float:
    """Where the tip of a tool sits in the head of a screw."""
    return float(bench.part(name).vertices_mm[:, 2].max()) - 2.0
