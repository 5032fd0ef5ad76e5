"""The workbench while a take is being scripted: where everything is, and the keys written so far.

Mutable only while `activities` writes a take; afterwards only its `tracks` and `segments` are kept.
"""

from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.grasps import grasp_angles_rad
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import HandPose, forward_kinematics
from assemblyhands_core.synthetic.grips import FLESH_MM, GripKind, HandGrip, solve_grips
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
    rotation_vector,
    shifted,
)
from assemblyhands_core.synthetic.objects import Grip, Part, PartSet
from assemblyhands_core.synthetic.person import Subject

Verb = Literal["pick up", "put down", "position", "remove", "screw", "unscrew"]

MAX_DESIGN_SPEED_MM_S: Final = 1100.0
"""Peak speed that a reach is timed for, before tremor, the other hand's motion and turning add to it."""
BACK_OFF_MM: Final = 50.0
"""From where a hand reaches for something and to where it draws back, along the grip."""
_LEVER_MM: Final = 170.0

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


@dataclass(frozen=True, eq=False)
class Ways:
    """All the ways in which a hand could hold a part, in the part's frame, mm.

    Attributes:
        T_part_from_grip: Places of the grip.
        T_part_from_wrist: Places of the hand.
        grips: The grip in the hand, of each way.
        joints_mm: The hand's joints: closed, open, and open but drawn back along the grip by `BACK_OFF_MM`.
        clearance_mm: Least distance of the closed hand's skin to the part's surface, negative inside.
    """

    T_part_from_grip: Float64[np.ndarray, "way 4 4"]
    T_part_from_wrist: Float64[np.ndarray, "way 4 4"]
    grips: tuple[HandGrip, ...]
    joints_mm: Float64[np.ndarray, "way 63 3"]
    clearance_mm: Float64[np.ndarray, " way"]

    def held(self, name: str, index: int) -> Held:
        """Return one way as what a hand holds."""
        return Held(name, self.T_part_from_grip[index], self.grips[index])


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
    _grips: dict[tuple[GripKind, Hand], tuple[HandGrip, ...]] = field(default_factory=dict)
    _ways: dict[tuple[str, Grip, Hand], Ways] = field(default_factory=dict)

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

    def ways(self, name: str, grip: Grip, hand: Hand) -> Ways:
        """Return how this person can take hold of a part by one of its grips, worked out once."""
        key = name, grip, hand
        if key not in self._ways:
            solved = self._solved(grip.kind, hand)
            places = gripped(grip)
            pairs = [(place, one) for place in places for one in solved]
            self._ways[key] = self._ways_of(name, np.stack([p for p, _ in pairs]), tuple(g for _, g in pairs), hand)
        return self._ways[key]

    def present_way(self, hand: Hand) -> Ways:
        """Return the one way in which a hand holds what it holds."""
        held = self.held[hand]
        return self._ways_of(held.part, held.T_part_from_grip[None], (held.grip,), hand)

    def _solved(self, kind: GripKind, hand: Hand) -> tuple[HandGrip, ...]:
        if (kind, hand) not in self._grips:
            self._grips[kind, hand] = solve_grips(self.subject.hand_shape.skeleton, kind, hand)
        return self._grips[kind, hand]

    def _ways_of(
        self, name: str, places: Float64[np.ndarray, "way 4 4"], grips: tuple[HandGrip, ...], hand: Hand
    ) -> Ways:
        wrists = places @ np.stack([transforms.inverse(grip.T_wrist_from_grip) for grip in grips])
        skeleton = self.subject.hand_shape.skeleton
        joints = [
            forward_kinematics(skeleton, HandPose(hand, wrists, np.stack([getattr(grip, bend) for grip in grips])))
            for bend in ("closed_rad", "open_rad")
        ]
        clearance = (self.part(name).signed_distance_mm(joints[0]) - FLESH_MM).min(axis=-1)
        back = joints[1] - BACK_OFF_MM * places[:, None, :3, 2]
        return Ways(places, wrists, grips, np.concatenate([*joints, back], axis=1), clearance)

    def carrier(self, name: str) -> str:
        """Return what carries a part in the end: the world or a hand."""
        carrier = self.part_keys[name][-1].carrier
        return self.carrier(carrier) if carrier in self.part_keys else carrier

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
            self._append(hand, replace(last, t_s=t_s, arc_mm=np.zeros(3)))
        return max(t_s, last.t_s)

    def leave_frame(self, hand: Hand, t_s: float) -> None:
        """Let a hand stay where it is in the world from an instant on, whatever becomes of what it worked on."""
        self.wait(hand, t_s)
        last = self.hand_keys[hand][-1]
        T_world_from_grip = self.at(last.t_s).T_world_from(last.frame) @ last.T_frame_from_grip
        self._append(hand, replace(last, frame=WORLD, T_frame_from_grip=T_world_from_grip))

    def move(self, hand: Hand, key: HandKey) -> float:
        """Add a key, later than it says where the way would be too fast; returns its time."""
        last = self.hand_keys[hand][-1]
        needed = self.move_s(hand, key)
        key = replace(key, t_s=max(key.t_s, last.t_s + needed))
        self._append(hand, key)
        return key.t_s

    def _append(self, hand: Hand, key: HandKey) -> None:
        """Add a key after noting how its frame and that of the key before lie at its instant."""
        then, last = self.at(key.t_s), self.hand_keys[hand][-1].frame
        rotations = (then.T_world_from(frame)[:3, :3] for frame in (key.frame, last))
        self.hand_keys[hand].append(replace(key, frame_then=next(rotations), last_frame_then=next(rotations)))

    def move_s(self, hand: Hand, key: HandKey) -> float:
        """Return how long the way to a key takes at least, from the last one."""
        last = self.hand_keys[hand][-1]
        now = self.at(last.t_s)
        later = self.at(max(key.t_s, last.t_s))
        start = now.T_world_from(last.frame) @ last.T_frame_from_grip @ transforms.inverse(last.T_wrist_from_grip)
        end = later.T_world_from(key.frame) @ key.T_frame_from_grip @ transforms.inverse(key.T_wrist_from_grip)
        turn = rotation_vector(start[:3, :3].T @ end[:3, :3])
        distance = float(np.linalg.norm(end[:3, 3] - start[:3, 3])) + float(np.linalg.norm(key.arc_mm))
        distance += _LEVER_MM * float(np.linalg.norm(turn))
        bend = 70.0 * float(np.abs(key.angles_rad - last.angles_rad).max())
        return PEAK_OVER_MEAN_SPEED * (distance + bend) / MAX_DESIGN_SPEED_MM_S * max(self.tempo, 0.85)

    def carry(self, name: str, carrier: str, T_carrier_from_part: Rigid, t_s: float) -> None:
        """Let a part be carried from an instant on."""
        self.part_keys[name].append(PartKey(t_s, carrier, T_carrier_from_part))

    def label(self, verb: Verb, name: str, hand: Hand, start_s: float, end_s: float) -> None:
        """Note an action."""
        self.segments.append(Segment(verb, self.part(name).noun, name, hand, start_s, end_s))


def gripped(grip: Grip) -> Float64[np.ndarray, "n 4 4"]:
    """Return all `T_part_from_grip` of a grip: around the part, rolled about the grip."""
    turns = [about_z(2 * np.pi * i / grip.num_turns) for i in range(grip.num_turns)]
    rolls = [about_z(2 * np.pi * i / grip.num_rolls) for i in range(grip.num_rolls)]
    return np.stack([turn @ grip.T_part_from_grip @ roll for turn in turns for roll in rolls])


def free_key(t_s: float, T_world_from_wrist: Rigid) -> HandKey:
    """Return the key of an empty, relaxed hand."""
    return HandKey(t_s, WORLD, T_world_from_wrist, np.eye(4), grasp_angles_rad("relaxed"))
