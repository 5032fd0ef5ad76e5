"""Who sits at the table, and how the upper body follows the hands.

Skeleton only: what is drawn around it is in `figure`. World: mm, +y up; the person sits at negative x, faces +x and has
the right hand towards +z (see `rig`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import AVERAGE_HAND_LENGTH_MM
from assemblyhands_core.synthetic.bodies import Color
from assemblyhands_core.synthetic.hand_shape import HandShape
from assemblyhands_core.synthetic.motion import rotation

Sleeve = Literal["short", "half", "long"]

SIDE: Final[Mapping[Hand, float]] = {"right": 1.0, "left": -1.0}
"""Sign of world z on a person's side."""

_CLOTHES: Final[tuple[Color, ...]] = (
    (0.05, 0.06, 0.09),
    (0.42, 0.42, 0.42),
    (0.03, 0.10, 0.26),
    (0.33, 0.04, 0.05),
    (0.05, 0.20, 0.10),
    (0.55, 0.45, 0.30),
    (0.70, 0.70, 0.72),
    (0.16, 0.09, 0.22),
)
_HAIR: Final[tuple[Color, ...]] = (
    (0.012, 0.010, 0.010),
    (0.045, 0.022, 0.012),
    (0.13, 0.065, 0.03),
    (0.36, 0.24, 0.10),
    (0.30, 0.30, 0.30),
)
_GLOVES: Final[tuple[Color, ...]] = ((0.05, 0.16, 0.42), (0.03, 0.03, 0.035), (0.62, 0.62, 0.60))


@dataclass(frozen=True, eq=False)
class Subject:
    """A person.

    Attributes:
        seed: Decides on everything below.
        hand_shape: Bones and skin of the hands.
        dominant: The hand that works; the other one holds.
        scale: Of arms and trunk, 1 for an average adult.
        sleeve: How far it covers the arm.
        shirt: Linear RGB.
        is_striped: Whether the shirt has a pattern.
        hair: Linear RGB.
        watch: The hand above which a watch is worn, if any.
        gloves: Their colour, if any are worn.
    """

    seed: int
    hand_shape: HandShape
    dominant: Hand
    scale: float
    sleeve: Sleeve
    shirt: Color
    is_striped: bool
    hair: Color
    watch: Hand | None
    gloves: Color | None

    @classmethod
    def from_seed(cls, seed: int) -> "Subject":
        """Draw a subject; one in ten is left-handed, one in three wears a watch, one in eight gloves."""
        rng = np.random.default_rng([seed, 0x5B])
        shape = HandShape.from_seed(seed)
        length = float(shape.skeleton.bases_mm[2, 1] + shape.skeleton.phalanges_mm[2].sum())
        dominant: Hand = "left" if rng.random() < 0.1 else "right"
        sleeves: tuple[Sleeve, ...] = ("short", "half", "long")
        off_hand: Hand = "right" if dominant == "left" else "left"
        return cls(
            seed=seed,
            hand_shape=shape,
            dominant=dominant,
            scale=float(np.clip(length / AVERAGE_HAND_LENGTH_MM * rng.normal(1.0, 0.02), 0.88, 1.12)),
            sleeve=sleeves[int(rng.choice(3, p=(0.4, 0.2, 0.4)))],
            shirt=_CLOTHES[int(rng.integers(len(_CLOTHES)))],
            is_striped=bool(rng.random() < 0.4),
            hair=_HAIR[int(rng.integers(len(_HAIR)))],
            watch=off_hand if rng.random() < 0.33 else None,
            gloves=_GLOVES[int(rng.integers(len(_GLOVES)))] if rng.random() < 0.125 else None,
        )

    @property
    def upper_arm_mm(self) -> float:
        """Shoulder to elbow."""
        return 300.0 * self.scale

    @property
    def forearm_mm(self) -> float:
        """Elbow to wrist."""
        return 258.0 * self.scale


@dataclass(frozen=True, eq=False)
class Posture:
    """The upper body at one instant, in world mm.

    Attributes:
        T_world_from_trunk: Origin between the hips, x ahead, y up along the spine, z to the right.
        shoulders_mm: Of each arm.
        elbows_mm: Of each arm.
        wrists_mm: Of each arm.
        neck_mm: Base of the neck.
    """

    T_world_from_trunk: Float64[np.ndarray, "4 4"]
    shoulders_mm: Mapping[Hand, Float64[np.ndarray, "3"]]
    elbows_mm: Mapping[Hand, Float64[np.ndarray, "3"]]
    wrists_mm: Mapping[Hand, Float64[np.ndarray, "3"]]
    neck_mm: Float64[np.ndarray, "3"]


HIPS_WORLD_MM: Final = (-330.0, -240.0, 80.0)
_SHOULDER_MM: Final = (10.0, 520.0, 172.0)
_NECK_MM: Final = (5.0, 560.0, 0.0)
_HIGHEST_SWING: Final = np.array([np.inf, 0.3, np.inf])
"""Elbows follow a hand sideways rather than up."""
_NOMINAL_LEAN_RAD: Final = 0.10
_REACH: Final = 0.97
"""Share of the arm's length beyond which the shoulder follows the hand instead of the arm getting straighter."""


def sit(
    subject: Subject,
    T_world_from_wrist: Mapping[Hand, Float64[np.ndarray, "4 4"]],
    followed_mm: Mapping[Hand, Float64[np.ndarray, "3"]],
) -> Posture:
    """Seat the person so that both hands are where they are: lean, turn and both arms.

    Args:
        subject: Lengths of the arms.
        T_world_from_wrist: Both hands, mm.
        followed_mm: What the trunk leans and turns towards, for each hand: its place on average, so that the trunk is
            slower than the hands.

    Returns:
        The same for the same hands: it has no memory. Arms keep their lengths; for far hands shoulders come along.
    """
    wrists = {hand: T_world_from_wrist[hand][:3, 3] for hand in HANDS}
    trunk = _trunk(followed_mm)
    shoulders = {}
    for hand in HANDS:
        local = subject.scale * np.array(_SHOULDER_MM) * (1.0, 1.0, SIDE[hand])
        shoulders[hand] = _within_reach(subject, transforms.apply(trunk, local), wrists[hand])
    forward = {hand: T_world_from_wrist[hand][:3, 1] for hand in HANDS}
    elbows = {hand: elbow_mm(subject, hand, shoulders[hand], wrists[hand], forward[hand]) for hand in HANDS}
    return Posture(trunk, shoulders, elbows, wrists, transforms.apply(trunk, subject.scale * np.array(_NECK_MM)))


def resting_shoulder_mm(subject: Subject, hand: Hand) -> Float64[np.ndarray, "3"]:
    """Return where a shoulder is while the hands work in the middle."""
    local = subject.scale * np.array(_SHOULDER_MM) * (1.0, 1.0, SIDE[hand])
    return transforms.apply(_leaning(_NOMINAL_LEAN_RAD, 0.0), local)


def elbow_mm(
    subject: Subject,
    hand: Hand,
    shoulder_mm: Float64[np.ndarray, "3"],
    wrist_mm: Float64[np.ndarray, "*batch 3"],
    forward: Float64[np.ndarray, "*batch 3"],
) -> Float64[np.ndarray, "*batch 3"]:
    """Place the elbow of an arm by two-bone inverse kinematics.

    Args:
        subject: Lengths of the arm.
        hand: Which arm.
        shoulder_mm: World.
        wrist_mm: World, within reach.
        forward: Unit y axis of the hand in the world: the elbow hangs down and outwards, and swings to where the
            forearm continues the hand.

    Returns:
        World mm, at the exact lengths of both bones.
    """
    upper, fore = subject.upper_arm_mm, subject.forearm_mm
    reach = wrist_mm - shoulder_mm
    distance = np.linalg.norm(reach, axis=-1, keepdims=True)
    along = reach / distance
    share = (upper * upper - fore * fore + distance * distance) / (2 * distance)
    height = np.sqrt(np.maximum(upper * upper - share * share, 0.0))
    in_line = np.minimum((wrist_mm - fore * forward - shoulder_mm) / upper, _HIGHEST_SWING)
    pole = np.array([-0.25, -1.0, 0.55 * SIDE[hand]]) + 1.6 * in_line
    pole = pole - along * (pole * along).sum(axis=-1, keepdims=True)
    pole = pole / np.linalg.norm(pole, axis=-1, keepdims=True)
    return np.asarray(shoulder_mm + share * along + height * pole)


def _trunk(hands_mm: Mapping[Hand, Float64[np.ndarray, "3"]]) -> Float64[np.ndarray, "4 4"]:
    """Lean and turn towards the hands, softly limited."""
    ahead = 0.5 * (hands_mm["right"][0] + hands_mm["left"][0]) - 70.0
    twist = hands_mm["right"][0] - hands_mm["left"][0]
    lean = _NOMINAL_LEAN_RAD + 0.14 * np.tanh(ahead / 160.0)
    return _leaning(float(lean), float(0.22 * np.tanh(twist / 300.0)))


def _leaning(lean_rad: float, twist_rad: float) -> Float64[np.ndarray, "4 4"]:
    """Lean forwards about the hips, after turning to the left about the spine."""
    turn = rotation(np.array([0.0, 0.0, -lean_rad])) @ rotation(np.array([0.0, twist_rad, 0.0]))
    return transforms.rigid(turn, np.array(HIPS_WORLD_MM))


def _within_reach(
    subject: Subject, shoulder_mm: Float64[np.ndarray, "3"], wrist_mm: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "3"]:
    """Move the shoulder towards a hand that is too far away, smoothly (a soft maximum of 15 mm)."""
    reach = wrist_mm - shoulder_mm
    distance = float(np.sqrt(reach @ reach))
    excess = distance - _REACH * (subject.upper_arm_mm + subject.forearm_mm)
    follow = 15.0 * float(np.logaddexp(0.0, excess / 15.0))
    return np.asarray(shoulder_mm + reach / distance * follow)


def wrist_bend_rad(
    elbow_world_mm: Float[np.ndarray, "*batch 3"], T_world_from_wrist: Float[np.ndarray, "*batch 4 4"]
) -> Float64[np.ndarray, "*batch 2"]:
    """Measure how a hand is bent against its forearm: flexion towards the palm, deviation towards the hand's -x."""
    forearm = T_world_from_wrist[..., :3, 3] - elbow_world_mm
    forearm = forearm / np.linalg.norm(forearm, axis=-1, keepdims=True)
    local = np.einsum("...ji,...j->...i", T_world_from_wrist[..., :3, :3], forearm)
    deviation = np.arctan2(local[..., 0], np.hypot(local[..., 1], local[..., 2]))
    return np.stack([np.arctan2(local[..., 2], local[..., 1]), deviation], axis=-1)


def forearm_twist_rad(
    hand: Hand,
    shoulder_mm: Float[np.ndarray, "3"],
    elbow_world_mm: Float[np.ndarray, "*batch 3"],
    T_world_from_wrist: Float[np.ndarray, "*batch 4 4"],
) -> Float64[np.ndarray, "*batch"]:
    """Measure the turn of the forearm: 0 with the thumb towards the shoulder, positive palm down (pronation)."""
    forearm = T_world_from_wrist[..., :3, 3] - elbow_world_mm
    forearm = forearm / np.linalg.norm(forearm, axis=-1, keepdims=True)
    neutral = _across(shoulder_mm - elbow_world_mm, forearm)
    thumb = _across(-SIDE[hand] * T_world_from_wrist[..., :3, 0], forearm)
    sine = (np.cross(neutral, thumb) * forearm).sum(axis=-1)
    return np.asarray(-SIDE[hand] * np.arctan2(sine, (neutral * thumb).sum(axis=-1)))


def _across(
    vector: Float[np.ndarray, "*batch 3"], axis: Float[np.ndarray, "*batch 3"]
) -> Float64[np.ndarray, "*batch 3"]:
    """The part of a vector across a unit axis."""
    return np.asarray(vector - axis * (vector * axis).sum(axis=-1, keepdims=True))
