"""A take: someone at the table for some seconds, as a pure function of time."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.hands.kinematics import HandPose, forward_kinematics
from assemblyhands_core.synthetic.activities import write_script
from assemblyhands_core.synthetic.bench import Segment
from assemblyhands_core.synthetic.gaze import Gaze
from assemblyhands_core.synthetic.motion import Instant, Tracks
from assemblyhands_core.synthetic.objects import PartSet
from assemblyhands_core.synthetic.person import Posture, Subject, sit
from assemblyhands_core.synthetic.toys import SetKind, draw_set

MAX_JOINT_SPEED_MM_S: Final = 2500.0
"""No joint of a hand is ever faster (tested); hands that reach for things peak at 1 to 1.5 m/s."""

_SCRIPT_STREAM: Final = 0x7A4E
_GAZE_STREAM: Final = 0x6A2E
# The trunk and the head follow the hands as they are on average over this time around an instant.
_FOLLOW_S: Final = np.linspace(-0.75, 0.75, 7)
_FOLLOW_WEIGHTS: Final = np.array([1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0]) / 16.0


@dataclass(frozen=True, eq=False)
class State:
    """Everything that moves, at one instant.

    Attributes:
        t_s: The instant.
        hands: Pose of each hand.
        joints_world_mm: Right hand 0-20, left hand 21-41.
        T_world_from_part: Pose of every part by name, mm.
        posture: Trunk and arms.
        T_headset_from_world: Rigid, mm; the headset's frame is that of `headset`.
        segments: Actions that go on.
    """

    t_s: float
    hands: Mapping[Hand, HandPose]
    joints_world_mm: Float64[np.ndarray, "42 3"]
    T_world_from_part: Mapping[str, Float64[np.ndarray, "4 4"]]
    posture: Posture
    T_headset_from_world: Float64[np.ndarray, "4 4"]
    segments: tuple[Segment, ...]

    @property
    def action(self) -> tuple[str, str]:
        """Return verb and noun of what is being done, of the action that began first; empty between actions."""
        return (self.segments[0].verb, self.segments[0].noun) if self.segments else ("", "")


@dataclass(frozen=True, eq=False)
class Take:
    """One recording's worth of motion.

    Attributes:
        subject: Who works.
        seed: Of everything but the subject.
        kind: Which things lie on the table.
        duration_s: Length; states exist beyond it, at rest.
        parts: What lies on the table.
        tracks: Ways of hands and parts.
        gaze: Where the head turns.
        segments: Labelled actions within the take, by start; those that the end cuts are shortened.
    """

    subject: Subject
    seed: int
    kind: SetKind
    duration_s: float
    parts: PartSet
    tracks: Tracks
    gaze: Gaze
    segments: tuple[Segment, ...]

    @classmethod
    def from_seed(cls, subject: int, seed: int, duration_s: float, kind: SetKind = "assembly") -> "Take":
        """Draw a take; same arguments, same bytes, and a shorter one is the beginning of a longer one.

        Args:
            subject: Seed of the person.
            seed: Of toy and script.
            duration_s: Length, s.
            kind: "assembly" or "desktop".
        """
        person = Subject.from_seed(subject)
        rng = np.random.default_rng([subject, seed, _SCRIPT_STREAM, int(kind == "desktop")])
        parts = draw_set(kind, rng)
        bench = write_script(person, parts, rng, duration_s + _FOLLOW_S[-1])
        gaze = Gaze.from_rng(np.random.default_rng([subject, seed, _GAZE_STREAM]), duration_s)
        cut = (_cut(segment, duration_s) for segment in bench.segments)
        segments = sorted((s for s in cut if s is not None), key=lambda segment: segment.start_s)
        return cls(person, seed, kind, duration_s, parts, bench.tracks, gaze, tuple(segments))

    def state_at(self, t_s: float) -> State:
        """Return everything that moves at any instant, independently of what was asked before."""
        now = self.tracks.at(t_s)
        hands = {hand: HandPose(hand, now.T_world_from(hand), now.angles_rad(hand)) for hand in HANDS}
        followed = self._followed_mm(t_s)
        posture = sit(self.subject, {hand: hands[hand].T_world_from_wrist for hand in HANDS}, followed)
        return State(
            t_s=t_s,
            hands=hands,
            joints_world_mm=self.joints_at(t_s),
            T_world_from_part={name: now.T_world_from(name) for name in self.parts.parts},
            posture=posture,
            T_headset_from_world=self.gaze.T_headset_from_world(t_s, posture, followed),
            segments=tuple(segment for segment in self.segments if segment.start_s <= t_s < segment.end_s),
        )

    def joints_at(self, t_s: float) -> Float64[np.ndarray, "42 3"]:
        """Return the joints alone, right hand first: less than half of the work of `state_at`."""
        now, skeleton = self.tracks.at(t_s), self.subject.hand_shape.skeleton
        poses = [HandPose(hand, now.T_world_from(hand), now.angles_rad(hand)) for hand in HANDS]
        return np.concatenate([forward_kinematics(skeleton, pose) for pose in poses])

    def _followed_mm(self, t_s: float) -> Mapping[Hand, Float64[np.ndarray, "3"]]:
        """The hands' mean places around an instant: a little ahead of the wrists."""
        instants = [self.tracks.at(t_s + offset) for offset in _FOLLOW_S.tolist()]
        return {hand: _FOLLOW_WEIGHTS @ np.stack([_palm_mm(now, hand) for now in instants]) for hand in HANDS}


def _palm_mm(now: Instant, hand: Hand) -> Float64[np.ndarray, "3"]:
    return transforms.apply(now.T_world_from(hand), np.array([0.0, 80.0, -20.0]))


def _cut(segment: Segment, duration_s: float) -> Segment | None:
    """The part of a segment within the take, if at least a tenth of a second is."""
    end_s = min(segment.end_s, duration_s)
    if end_s - segment.start_s < 0.1:
        return None
    return Segment(segment.verb, segment.noun, segment.part, segment.hand, segment.start_s, end_s)
