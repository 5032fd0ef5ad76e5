"""The workbench while a take is being scripted: where everything is, and the keys written so far.

Mutable only while `activities` writes a take; afterwards only its `tracks` and `segments` are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.grasps import grasp_angles_rad
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import HandPose, forward_kinematics
from assemblyhands_core.synthetic.grips import HandGrip, solve_grip
from assemblyhands_core.synthetic.motion import (
    PEAK_OVER_MEAN_SPEED,
    WORLD,
    HandKey,
    HandTrack,
    Instant,
    PartKey,
    PartTrack,
    Tracks,
    Tremor,
    about_z,
    rotation,
    rotation_vector,
    shifted,
)
from assemblyhands_core.synthetic.objects import Grip, Part, PartSet
from assemblyhands_core.synthetic.person import Subject

Verb = Literal["pick up", "put down", "position", "remove", "screw", "unscrew"]

MAX_DESIGN_SPEED_MM_S: Final = 1100.0
"""Peak speed that a reach is timed for, before tremor, the other hand's motion and turning add to it."""
MIN_MOVE_S: Final = 0.3
_LEVER_MM: Final = 170.0
_ARC_SPEED: Final = 1.0

Rigid = Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class Segment:
    """One labelled action.

    Attributes:
        verb: One of the six.
        noun: What is handled.
        part: Its name.
        hand: Which hand does it.
        start_s: First instant.
        end_s: End.
    """

    verb: Verb
    noun: str
    part: str
    hand: Hand
    start_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class Held:
    """What a hand holds and how.

    Attributes:
        part: Name.
        T_part_from_grip: Where on the part, mm.
        grip: How.
    """

    part: str
    T_part_from_grip: Rigid
    grip: HandGrip

    @property
    def T_wrist_from_part(self) -> Rigid:
        """Where the part is in the hand."""
        return np.asarray(self.grip.T_wrist_from_grip @ transforms.inverse(self.T_part_from_grip))


@dataclass(eq=False)
class Bench:
    """State and script.

    Attributes:
        subject: Who works.
        parts: What with.
        rng: Of the take.
        tempo: Factor on the time that everything takes.
        hand_keys: Script of each hand.
        part_keys: Script of each part.
        segments: Labels.
        held: What each hand holds.
        mounted: Names of parts on their mounts, with the turn they are on at (rad) and how far they stand out (mm).
    """

    subject: Subject
    parts: PartSet
    rng: np.random.Generator
    tempo: float
    hand_keys: dict[Hand, list[HandKey]] = field(default_factory=lambda: {hand: [] for hand in HANDS})
    part_keys: dict[str, list[PartKey]] = field(default_factory=dict)
    segments: list[Segment] = field(default_factory=list)
    held: dict[Hand, Held] = field(default_factory=dict)
    mounted: dict[str, tuple[float, float]] = field(default_factory=dict)
    _grips: dict[tuple[str, float, Hand], HandGrip] = field(default_factory=dict)

    def __post_init__(self) -> None:
        tremors = {hand: Tremor.from_rng(self.rng) for hand in HANDS}
        self.part_keys = {name: [] for name in self.parts.parts}
        self.tracks = Tracks(
            {hand: HandTrack(self.hand_keys[hand], tremors[hand]) for hand in HANDS},
            {name: PartTrack(keys) for name, keys in self.part_keys.items()},
        )

    @property
    def worker(self) -> Hand:
        """The hand that works."""
        return self.subject.dominant

    @property
    def holder(self) -> Hand:
        """The hand that holds."""
        return "left" if self.worker == "right" else "right"

    def part(self, name: str) -> Part:
        """Return a part by name."""
        return self.parts.parts[name]

    def at(self, t_s: float) -> Instant:
        """Return where everything is at an instant, as far as it is scripted."""
        return self.tracks.at(t_s)

    def end_s(self, hand: Hand) -> float:
        """Return until when a hand is busy."""
        return self.hand_keys[hand][-1].t_s

    def grip(self, grip: Grip, hand: Hand) -> HandGrip:
        """Return how this person takes hold, solved for once."""
        key = grip.kind.contact, grip.kind.width_mm, hand
        if key not in self._grips:
            self._grips[key] = solve_grip(self.subject.hand_shape.skeleton, grip.kind, hand)
        return self._grips[key]

    def joints_mm(
        self, hand: Hand, T_frame_from_wrist: Rigid, angles_rad: Float64[np.ndarray, "20"]
    ) -> Float64[np.ndarray, "21 3"]:
        """Return the joints of a hand in any frame."""
        pose = HandPose(hand, T_frame_from_wrist, angles_rad)
        return forward_kinematics(self.subject.hand_shape.skeleton, pose)

    def is_tight(self, name: str) -> bool:
        """Tell whether a part on its mount is screwed in."""
        mount = self.part(name).mount
        return name in self.mounted and mount is not None and mount.travel_mm > 0 and self.mounted[name][1] == 0.0

    def is_loose(self, name: str) -> bool:
        """Tell whether a part is on its mount and could be taken off, but for what is mounted on it."""
        return name in self.mounted and not self.is_tight(name)

    def mounted_children(self, name: str) -> tuple[str, ...]:
        """Return what is mounted on a part."""
        return tuple(child for child in self.parts.children[name] if child in self.mounted)

    def is_on_table(self, name: str) -> bool:
        """Tell whether a part lies on the table, neither held nor mounted."""
        return name not in self.mounted and all(held.part != name for held in self.held.values())

    def T_parent_from_mounted(self, name: str, turn_rad: float, out_mm: float) -> Rigid:
        """Return a part's pose on its mount, turned about its axis and standing out."""
        mount = self.part(name).mount
        if mount is None:
            raise ValueError(f"Part {name} has no mount, so that it cannot be put on anything: give it one.")
        return np.asarray(mount.T_parent_from_part @ about_z(turn_rad) @ shifted(z_mm=out_mm))

    def wait(self, hand: Hand, t_s: float) -> float:
        """Keep a hand as it is until an instant; returns when it is free."""
        last = self.hand_keys[hand][-1]
        if t_s > last.t_s:
            self.hand_keys[hand].append(replace(last, t_s=t_s, arc_mm=0.0))
        return max(t_s, last.t_s)

    def leave_frame(self, hand: Hand, t_s: float) -> None:
        """Let a hand stay where it is in the world from an instant on, whatever becomes of what it worked on."""
        self.wait(hand, t_s)
        last = self.hand_keys[hand][-1]
        T_world_from_grip = self.at(last.t_s).T_world_from(last.frame) @ last.T_frame_from_grip
        self.hand_keys[hand].append(replace(last, frame=WORLD, T_frame_from_grip=T_world_from_grip))

    def move(self, hand: Hand, key: HandKey) -> float:
        """Add a key, later than it says where the way would be too fast; returns its time."""
        last = self.hand_keys[hand][-1]
        needed = self.move_s(hand, key)
        key = replace(key, t_s=max(key.t_s, last.t_s + needed))
        self.hand_keys[hand].append(key)
        return key.t_s

    def move_s(self, hand: Hand, key: HandKey) -> float:
        """Return how long the way to a key takes at least, from the last one."""
        last = self.hand_keys[hand][-1]
        now = self.at(last.t_s)
        later = self.at(max(key.t_s, last.t_s))
        start = now.T_world_from(last.frame) @ last.T_frame_from_grip @ transforms.inverse(last.T_wrist_from_grip)
        end = later.T_world_from(key.frame) @ key.T_frame_from_grip @ transforms.inverse(key.T_wrist_from_grip)
        turn = rotation_vector(start[:3, :3].T @ end[:3, :3])
        distance = float(np.linalg.norm(end[:3, 3] - start[:3, 3])) + _ARC_SPEED * key.arc_mm
        distance += _LEVER_MM * float(np.linalg.norm(turn))
        bend = 70.0 * float(np.abs(key.angles_rad - last.angles_rad).max())
        return PEAK_OVER_MEAN_SPEED * (distance + bend) / MAX_DESIGN_SPEED_MM_S

    def carry(self, name: str, carrier: str, T_carrier_from_part: Rigid, t_s: float) -> None:
        """Let a part be carried from an instant on."""
        self.part_keys[name].append(PartKey(t_s, carrier, T_carrier_from_part))

    def label(self, verb: Verb, name: str, hand: Hand, start_s: float, end_s: float) -> None:
        """Note an action."""
        self.segments.append(Segment(verb, self.part(name).noun, name, hand, start_s, end_s))


def gripped(grip: Grip, tilts_rad: Sequence[float]) -> Float64[np.ndarray, "n 4 4"]:
    """Return all `T_part_from_grip` of a grip: around the part, rolled about the grip, tilted about the contacts."""
    turns = [about_z(2 * np.pi * i / grip.num_turns) for i in range(grip.num_turns)]
    rolls = [about_z(2 * np.pi * i / grip.num_rolls) for i in range(grip.num_rolls)]
    tilts = [transforms.rigid(rotation(np.array([tilt, 0.0, 0.0])), np.zeros(3)) for tilt in tilts_rad]
    poses = [turn @ grip.T_part_from_grip @ roll @ tilt for turn in turns for roll in rolls for tilt in tilts]
    return np.stack(poses)


def free_key(t_s: float, T_world_from_wrist: Rigid, arc_mm: float = 0.0) -> HandKey:
    """Return the key of an empty, relaxed hand."""
    return HandKey(t_s, WORLD, T_world_from_wrist, np.eye(4), grasp_angles_rad("relaxed"), arc_mm)
