"""What every action at the table is made of: reaching, letting go, carrying, fitting, presenting."""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import BACK_OFF_MM, Bench, Held, Rigid, Ways
from assemblyhands_core.synthetic.clearance import apart_mm, hand_joints_mm, harm_at, nearest_mm, travel
from assemblyhands_core.synthetic.grips import HandGrip
from assemblyhands_core.synthetic.motion import WORLD, HandKey, about_z, rotation, shifted
from assemblyhands_core.synthetic.person import SIDE

OUT_MM: Final = 42.0
"""How far in front of its mount a part is before it is put on, and a tool before it is set down on a screw."""
LABEL_START: Final = 0.45
"""Share of a reach or transport after which its action has begun, as annotators see it."""
_NUM_LIFTS: Final = 4
_ROOM_MM: Final = 12.0
_REGRIP_COST: Final = 1.2


def hand_key(
    t_s: float,
    frame: str,
    T_frame_from_grip: Rigid,
    grip: HandGrip,
    is_open: bool = False,
    lift_mm: float = 0.0,
    tremor: float = 1.0,
) -> HandKey:
    """Return the key of a hand that grips, or with open fingers is about to or has just done so."""
    angles = grip.open_rad if is_open else grip.closed_rad
    return HandKey(t_s, frame, T_frame_from_grip, grip.T_wrist_from_grip, angles, np.array([0.0, lift_mm, 0.0]), tremor)


def reach(
    bench: Bench, hand: Hand, frame: str, T_frame_from_grip: Rigid, grip: HandGrip, earliest_s: float = 0.0
) -> tuple[float, float]:
    """Reach with open fingers and close them; returns when the hand is near and when it is closed."""
    back = T_frame_from_grip @ shifted(z_mm=-BACK_OFF_MM)
    start_s = max(bench.end_s(hand) + 0.3, earliest_s - 0.1)
    lift_mm = float(bench.rng.uniform(10.0, 35.0))
    near_s = travel(bench, hand, hand_key(start_s, frame, back, grip, True, lift_mm))
    there_s = bench.move(hand, hand_key(near_s + 0.22 * bench.tempo, frame, T_frame_from_grip, grip, True, tremor=0.0))
    closed_s = there_s + bench.tempo * bench.rng.uniform(0.14, 0.22)
    return near_s, bench.move(hand, hand_key(closed_s, frame, T_frame_from_grip, grip, tremor=0.0))


def let_go(bench: Bench, hand: Hand, frame: str, T_frame_from_grip: Rigid, grip: HandGrip) -> tuple[float, float]:
    """Open the fingers and draw the hand back; returns when it is open and when it is away."""
    open_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.14, 0.22)
    open_s = bench.move(hand, hand_key(open_s, frame, T_frame_from_grip, grip, True, tremor=0.0))
    back = T_frame_from_grip @ shifted(z_mm=-BACK_OFF_MM)
    return open_s, bench.move(hand, hand_key(open_s + 0.25 * bench.tempo, frame, back, grip, True))


def lift(bench: Bench, hand: Hand, T_world_from_grip: Rigid, grip: HandGrip) -> float:
    """Bring what was taken up and a little towards the middle, where there is room."""
    t_s = bench.end_s(hand) + 0.3 * bench.tempo
    keys = [hand_key(t_s, WORLD, _lifted(bench, T_world_from_grip), grip) for _ in range(_NUM_LIFTS)]
    return travel(bench, hand, min(keys, key=lambda key: harm_at(bench, hand, key)))


def _lifted(bench: Bench, T_world_from_grip: Rigid) -> Rigid:
    rng, lifted = bench.rng, T_world_from_grip.copy()
    to_middle = np.array([50.0, 120.0, 80.0]) - lifted[:3, 3]
    lifted[:3, 3] += to_middle * (rng.uniform(0.1, 0.35), 0.0, rng.uniform(0.0, 0.35))
    lifted[1, 3] = max(lifted[1, 3], rng.uniform(70.0, 120.0))
    lifted[:3, :3] = rotation(rng.normal(0.0, 0.12, 3)) @ lifted[:3, :3]
    return lifted


def wiggle(bench: Bench, hand: Hand, frame: str, place: Rigid, T_part_from_grip: Rigid, grip: HandGrip) -> None:
    """Turn a part to and fro a little, as one does to fit it in or to loosen it."""
    angle = bench.rng.uniform(0.06, 0.16)
    for number in range(min(int(bench.rng.geometric(0.45)), 7)):
        turn = angle * (-1) ** number
        t_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.16, 0.26)
        bench.move(hand, hand_key(t_s, frame, place @ about_z(turn) @ T_part_from_grip, grip))


def make_room(bench: Bench, hand: Hand, joints_world_mm: Float64[np.ndarray, "63 3"], t_s: float) -> None:
    """Let the other hand, and what it holds, give way where a hand is about to be."""
    other: Hand = "left" if hand == "right" else "right"
    now = bench.at(t_s)
    carried = [name for name in bench.parts.parts if bench.carrier(name) == other]
    gap = min(
        float(nearest_mm(bench, now, carried, joints_world_mm)),
        float(apart_mm(joints_world_mm, hand_joints_mm(bench, other, now))),
    )
    if gap > _ROOM_MM:
        return
    bench.leave_frame(other, t_s)
    last = bench.hand_keys[other][-1]
    aside = last.T_frame_from_grip.copy()
    aside[:3, 3] += (-20.0, max(150.0 - aside[1, 3], 20.0), SIDE[other] * 90.0)
    travel(bench, other, replace(last, t_s=t_s + 0.3, T_frame_from_grip=aside, tremor=1.0))


def take(bench: Bench, hand: Hand, held: Held, t_s: float) -> None:
    """Let a hand hold something from an instant on."""
    bench.held[hand] = held
    bench.carry(held.part, hand, held.T_wrist_from_part, t_s)


def turn_in_fingers(bench: Bench, hand: Hand, held: Held, start_s: float, end_s: float) -> None:
    """Change over to another grip of what is held, while the hand moves."""
    bench.carry(held.part, hand, bench.held[hand].T_wrist_from_part, start_s)
    take(bench, hand, held, end_s)


def regrip_cost(held: Held, ways: Ways) -> Float64[np.ndarray, " way"]:
    """How far the held part would have to be turned in the fingers for each way."""
    start = held.T_wrist_from_part[:3, :3]
    ends = np.swapaxes(ways.T_part_from_wrist[:, :3, :3], 1, 2)
    cosine = (np.einsum("ij,nij->n", start, ends) - 1) / 2
    return np.asarray(_REGRIP_COST * np.arccos(np.clip(cosine, -1.0, 1.0)))


def from_root(bench: Bench, root: str, name: str, t_s: float) -> Rigid:
    """Where a part is in the frame of what it is mounted on in the end."""
    now = bench.at(t_s)
    return np.asarray(transforms.inverse(now.T_world_from(root)) @ now.T_world_from(name))


def present(bench: Bench, root: str, T_world_from_root: Rigid, t_s: float) -> float:
    """Let the holding hand bring the workpiece to where it is worked on; returns when it is there."""
    hand = bench.holder
    held = bench.held.get(hand)
    if held is None or held.part != root:
        return t_s
    bench.wait(hand, t_s)
    return travel(bench, hand, hand_key(t_s, WORLD, T_world_from_root @ held.T_part_from_grip, held.grip))
