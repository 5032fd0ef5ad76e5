"""Smooth motion as a pure function of time: keys of hands and parts, and what lies between them.

A `HandKey` says where a hand is at one instant, in the world or in the frame of a part, so that a hand that works on
a held toy goes with it. Between two keys everything moves with minimum jerk (Flash & Hogan 1985): at rest at both ends
and with a peak speed of 15/8 of the mean. A `PartKey` says what carries a part from then on.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand

PEAK_OVER_MEAN_SPEED: Final = 15 / 8
"""Of a minimum-jerk movement."""

WORLD: Final = "world"

Frames = Callable[[str], Float64[np.ndarray, "4 4"]]
"""Gives `T_world_from_frame` of the world, a part or a hand (its wrist) at the instant asked for."""


@dataclass(frozen=True, eq=False)
class HandKey:
    """Where a hand is at an instant.

    Attributes:
        t_s: Instant.
        frame: What the grip is given in: "world" or the name of a part.
        T_frame_from_grip: Point and axes of the grip (see `grips`), mm.
        T_wrist_from_grip: Where that grip is in the hand, mm.
        angles_rad: Bend of the fingers.
        arc_mm: How far the way from the key before bulges, in the world.
        tremor: Share of the natural unrest; 0 where the hand touches something that does not move with it.
        frame_then: `R_world_from_frame` at the instant.
        last_frame_then: The same of the frame of the key before. Both are known when the key is written; without them
            the turn between frames that move would be ambiguous, and jump where it passes half a turn.
    """

    t_s: float
    frame: str
    T_frame_from_grip: Float64[np.ndarray, "4 4"]
    T_wrist_from_grip: Float64[np.ndarray, "4 4"]
    angles_rad: Float64[np.ndarray, "20"]
    arc_mm: Float64[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    tremor: float = 1.0
    frame_then: Float64[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))
    last_frame_then: Float64[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class PartKey:
    """What carries a part from an instant on, and where the part is in it.

    Attributes:
        t_s: Instant.
        carrier: "world", "right" or "left" (the wrist) or the name of another part.
        T_carrier_from_part: Rigid, mm; between two keys with one carrier it moves, otherwise it stays.
    """

    t_s: float
    carrier: str
    T_carrier_from_part: Float64[np.ndarray, "4 4"]


_Angles = Float64[np.ndarray, "20"]
_Key = TypeVar("_Key", HandKey, PartKey)


@dataclass(frozen=True)
class Tremor:
    """Slow, small unrest of a hand in the air: a sum of sines.

    Attributes:
        amplitude_mm: Along each axis, of the fastest sine.
        amplitude_rad: About each axis.
        phases_rad: One a sine and degree of freedom, from the seed of the take.
    """

    amplitude_mm: float
    amplitude_rad: float
    phases_rad: tuple[tuple[float, ...], ...]

    @classmethod
    def from_rng(cls, rng: np.random.Generator, amplitude_mm: float = 2.0, amplitude_rad: float = 0.02) -> "Tremor":
        """Draw the phases."""
        phases = rng.uniform(0.0, 2 * np.pi, (len(_TREMOR_HZ), 6))
        return cls(amplitude_mm, amplitude_rad, tuple(tuple(float(p) for p in row) for row in phases))

    def at(self, t_s: float, share: float) -> Float64[np.ndarray, "4 4"]:
        """Return the unrest as a rigid transform near the identity."""
        waves = np.sin(2 * np.pi * _TREMOR_HZ[:, None] * t_s + np.array(self.phases_rad)).sum(axis=0) * share
        return transforms.rigid(rotation(waves[3:] * self.amplitude_rad), waves[:3] * self.amplitude_mm)


_TREMOR_HZ: Final = np.array([0.23, 0.41, 0.77])


@dataclass(frozen=True, eq=False)
class HandTrack:
    """The way of one hand.

    Attributes:
        keys: In the order of time; before the first and after the last the hand stays.
        tremor: Its unrest in the air.
    """

    keys: Sequence[HandKey]
    tremor: Tremor

    def at(self, t_s: float, frames: Frames) -> tuple[Float64[np.ndarray, "4 4"], Float64[np.ndarray, "20"]]:
        """Return `T_world_from_wrist` (mm) and the angles (rad) at an instant."""
        before, after, share = _bracket(self.keys, t_s)
        if before is after or share == 0.0:
            T_world_from_grip = frames(before.frame) @ before.T_frame_from_grip
            wrist, angles = before.T_wrist_from_grip, before.angles_rad
        else:
            T_world_from_grip = _between(before, after, frames, share)
            wrist = interpolated(before.T_wrist_from_grip, after.T_wrist_from_grip, share)
            angles = before.angles_rad + share * (after.angles_rad - before.angles_rad)
        unrest = self.tremor.at(t_s, before.tremor + share * (after.tremor - before.tremor))
        return T_world_from_grip @ unrest @ transforms.inverse(wrist), angles


def _between(before: HandKey, after: HandKey, frames: Frames, share: float) -> Float64[np.ndarray, "4 4"]:
    """T_world_from_grip part of the way between two keys.

    The turn is that between both poses as they are in the world when the second is reached, after what the frames still
    lack of their turn until then.
    """
    first, second = frames(before.frame), frames(after.frame)
    start = first @ before.T_frame_from_grip
    end = second @ after.T_frame_from_grip
    place = start[:3, 3] + share * (end[:3, 3] - start[:3, 3]) + after.arc_mm * 16 * (share * (1 - share)) ** 2
    start_then = after.last_frame_then @ before.T_frame_from_grip[:3, :3]
    turn = _turned(start_then, after.frame_then @ after.T_frame_from_grip[:3, :3], share)
    if before.frame != WORLD or after.frame != WORLD:
        turn = _turned(first[:3, :3] @ after.last_frame_then.T, second[:3, :3] @ after.frame_then.T, share) @ turn
    return transforms.rigid(turn, place)


@dataclass(frozen=True, eq=False)
class PartTrack:
    """The way of one part; keys in the order of time."""

    keys: Sequence[PartKey]

    def at(self, t_s: float) -> tuple[str, Float64[np.ndarray, "4 4"]]:
        """Return what carries the part at an instant and `T_carrier_from_part` in mm."""
        before, after, share = _bracket(self.keys, t_s)
        if before.carrier != after.carrier or share == 0.0:
            return before.carrier, before.T_carrier_from_part
        return before.carrier, interpolated(before.T_carrier_from_part, after.T_carrier_from_part, share)


@dataclass(frozen=True, eq=False)
class Tracks:
    """The ways of both hands and all parts.

    Attributes:
        hands: A hand's keys may be given in the frame of a part that this hand does not carry.
        parts: By name.
    """

    hands: Mapping[Hand, HandTrack]
    parts: Mapping[str, PartTrack]

    def at(self, t_s: float) -> "Instant":
        """Return all that can be asked about an instant."""
        return Instant(self, t_s)


class Instant:
    """Where everything is at one instant; works out only what is asked for."""

    def __init__(self, tracks: Tracks, t_s: float) -> None:
        self._tracks, self._t_s = tracks, t_s
        self._frames: dict[str, Float64[np.ndarray, "4 4"]] = {WORLD: np.eye(4)}
        self._angles_rad: dict[str, _Angles] = {}

    def T_world_from(self, frame: str) -> Float64[np.ndarray, "4 4"]:
        """Return the pose of the world, a hand's wrist or a part, mm."""
        if frame not in self._frames:
            if frame in HANDS:
                track = self._tracks.hands["right" if frame == "right" else "left"]
                self._frames[frame], self._angles_rad[frame] = track.at(self._t_s, self.T_world_from)
            else:
                carrier, T_carrier_from_part = self._tracks.parts[frame].at(self._t_s)
                self._frames[frame] = self.T_world_from(carrier) @ T_carrier_from_part
        return self._frames[frame]

    def angles_rad(self, hand: Hand) -> Float64[np.ndarray, "20"]:
        """Return how the fingers of a hand are bent."""
        self.T_world_from(hand)
        return self._angles_rad[hand]


def minimum_jerk(share: float) -> float:
    """Return how far a minimum-jerk movement has come after a share of its time (both 0 to 1)."""
    s = min(max(share, 0.0), 1.0)
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


def interpolated(
    start: Float64[np.ndarray, "4 4"], end: Float64[np.ndarray, "4 4"], share: float
) -> Float64[np.ndarray, "4 4"]:
    """Go part of the way between two rigid transforms: straight, turning about one axis."""
    turn = _turned(start[:3, :3], end[:3, :3], share)
    return transforms.rigid(turn, start[:3, 3] + share * (end[:3, 3] - start[:3, 3]))


def _turned(
    start: Float64[np.ndarray, "3 3"], end: Float64[np.ndarray, "3 3"], share: float
) -> Float64[np.ndarray, "3 3"]:
    """Go part of the way between two rotations about one axis, the shorter way."""
    return np.asarray(start @ rotation(share * rotation_vector(start.T @ end)))


def rotation(vector_rad: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation about a vector by its length in rad (Rodrigues)."""
    angle = float(np.sqrt(vector_rad @ vector_rad))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))


def rotation_vector(matrix: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3"]:
    """Return axis times angle of a rotation, the angle within [0, π]; inverse of `rotation`."""
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine, cosine = float(np.sqrt(skew @ skew)) / 2, (float(np.trace(matrix)) - 1) / 2
    angle = float(np.arctan2(sine, cosine))
    if sine > 1e-6:
        return np.asarray(skew * (angle / (2 * sine)))
    if cosine > 0:
        return np.asarray(skew / 2)
    # Half a turn: the axis is a column of (R + I) / 2 = a aᵀ.
    outer = (matrix + np.eye(3)) / 2
    column = outer[:, int(np.argmax(np.diag(outer)))]
    return np.asarray(column / np.linalg.norm(column) * angle)


def about_z(angle_rad: float) -> Float64[np.ndarray, "4 4"]:
    """Return the turn about z as a rigid transform."""
    return transforms.rigid(rotation(np.array([0.0, 0.0, angle_rad])), np.zeros(3))


def shifted(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 0.0) -> Float64[np.ndarray, "4 4"]:
    """Return a shift as a rigid transform."""
    return transforms.rigid(np.eye(3), np.array([x_mm, y_mm, z_mm]))


def _bracket(keys: Sequence[_Key], t_s: float) -> tuple[_Key, _Key, float]:
    """The keys around an instant and the share of the way between them."""
    index = bisect_right(keys, t_s, key=lambda key: key.t_s)
    if index == 0:
        return keys[0], keys[0], 0.0
    if index == len(keys):
        return keys[-1], keys[-1], 0.0
    before, after = keys[index - 1], keys[index]
    return before, after, minimum_jerk((t_s - before.t_s) / (after.t_s - before.t_s))
