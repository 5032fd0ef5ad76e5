"""Training sets of verbs: clips of hand poses, varied anew each time.

Screwing and unscrewing turn in opposite senses, and a mirror exchanges the two: the mirror image of a right hand that
screws is a left hand that turns counter-clockwise. So mirroring has to leave these verbs alone or exchange their names.
The paper augments its training data for the same two, as they last long and are rare (Sec. 5); it does not say by how
much or how. Here they are shown more often, each time varied differently.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import cv2
import numpy as np
from jaxtyping import Float64, Int64

from assemblyhands_core.data.arrays import evenly_spread
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import PoseSequenceConfig, sequence_of
from assemblyhands_core.data.verb_segments import UNKNOWN_NOUN

Mirroring = Literal["off", "acyclic", "relabel"]

CYCLIC_VERBS: Final = ("screw", "unscrew")
"""Verbs that turn something, in one sense and in the other: mirrored, each is the other."""


@dataclass(frozen=True)
class VerbAugmentation:
    """How training clips differ from the plain ones; zeros and `off` switch it off.

    Attributes:
        crop_share: Largest share of a clip that is cut off, at its two ends together.
        speed_spread: Standard deviation of the logarithm of the speed. It shows where clips are padded; resampling
            undoes it.
        turn_deg: Largest turn about the vertical, to either side.
        vertical: Direction of the vertical in the poses' frame, of either sign; nobody but the rig's owner knows it.
        noise_mm: Standard deviation of each joint's noise along each axis, drawn anew at every instant.
        mirroring: `acyclic` mirrors clips of all verbs but the cyclic ones, so that left-handed poses say "not
            cyclic" where all people are right-handed; `relabel` mirrors all and exchanges the cyclic verbs, although
            a mirrored screw moves inwards where an unscrewed one moves outwards.
        mirror_share: Share of those clips that are mirrored.
    """

    crop_share: float
    speed_spread: float
    turn_deg: float
    vertical: tuple[float, float, float]
    noise_mm: float
    mirroring: Mirroring
    mirror_share: float

    def __post_init__(self) -> None:
        """Refuse a vertical without direction and shares that are none."""
        if not np.linalg.norm(self.vertical) > 0:
            raise ValueError(f"the vertical {self.vertical} has no direction; give the axis that stands on the table.")
        for name in ("crop_share", "mirror_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}={getattr(self, name)} is no share; choose 0 to 1.")


PLAIN: Final = VerbAugmentation(0.0, 0.0, 0.0, (0.0, 1.0, 0.0), 0.0, "off", 0.0)


@dataclass(frozen=True, eq=False)
class VerbClips:
    """A set of clips of which the verb is known.

    Attributes:
        clips: Segments with their context.
        verb: Of each clip, its place in `verbs`.
        noun: Of each clip, its place among the nouns, `UNKNOWN_NOUN` if it has none.
        verbs: The classes.
        config: What the network takes.
        augmentation: What is varied.
        seed: Of everything drawn; with turn and index it decides on a sample.
        order: Which clip each sample is of; a clip may occur several times.
    """

    clips: tuple[PoseClip, ...]
    verb: Int64[np.ndarray, " clip"]
    noun: Int64[np.ndarray, " clip"]
    verbs: tuple[str, ...]
    config: PoseSequenceConfig
    augmentation: VerbAugmentation
    seed: int
    order: Int64[np.ndarray, " sample"]

    @staticmethod
    def of(
        clips: Sequence[PoseClip],
        labels: Sequence[tuple[str, str]],
        verbs: tuple[str, ...],
        nouns: Sequence[str],
        config: PoseSequenceConfig,
        augmentation: VerbAugmentation,
        seed: int,
        oversampling: Mapping[str, int] | None = None,
    ) -> "VerbClips":
        """Take clips with their verbs and nouns; clips in which no hand is ever seen are left out.

        Args:
            clips: Of any recordings.
            labels: Verb and noun of each.
            verbs: The classes.
            nouns: Those that the network is told; others are `UNKNOWN_NOUN`.
            config: What the network takes.
            augmentation: What is varied.
            seed: Of everything drawn.
            oversampling: How often clips of a verb occur in an epoch, where it is not once.

        Raises:
            ValueError: A clip has a verb that is none of the classes, or an oversampled verb is none or less than once.
        """
        factors = dict.fromkeys(verbs, 1) | dict(oversampling or {})
        if odd := [verb for verb, factor in factors.items() if verb not in verbs or factor < 1]:
            raise ValueError(f"clips of {odd[0]!r} are to occur {factors[odd[0]]} times; name a class and 1 or more.")
        if others := [verb for verb, _ in labels if verb not in verbs]:
            raise ValueError(
                f"{len(others)} clips show {others[0]!r}, which is none of {verbs}; choose segments first."
            )
        seen = [(clip, label) for clip, label in zip(clips, labels, strict=True) if clip.observed.any()]
        places = {noun: place for place, noun in enumerate(nouns)}
        repeats = [factors[verb] for _, (verb, _) in seen]
        return VerbClips(
            clips=tuple(clip for clip, _ in seen),
            verb=np.array([verbs.index(verb) for _, (verb, _) in seen], dtype=np.int64),
            noun=np.array([places.get(noun, UNKNOWN_NOUN) for _, (_, noun) in seen], dtype=np.int64),
            verbs=verbs,
            config=config,
            augmentation=augmentation,
            seed=seed,
            order=np.repeat(np.arange(len(seen), dtype=np.int64), np.array(repeats, dtype=np.int64)),
        )

    def spread(self, count: int) -> "VerbClips":
        """Return a set of at most so many samples, evenly spread."""
        return replace(self, order=self.order[evenly_spread(len(self), count)])

    def shuffled(self, seed: int) -> "VerbClips":
        """Return the same clips with their verbs dealt out at random: a control, of which nothing can be learnt."""
        return replace(self, verb=np.random.default_rng(seed).permutation(self.verb))

    def __len__(self) -> int:
        """Return how many samples there are."""
        return len(self.order)

    def sample(self, index: int, turn: int) -> Mapping[str, Any]:
        """Return a sample's arrays by name.

        Returns:
            ``poses`` (3, T, 21, 2) float32; ``is_observed`` and ``is_interpolated`` (T, 2); ``verb``; ``noun``.
        """
        rng = np.random.default_rng([self.seed, turn, index])
        place = int(self.order[index])
        verb = int(self.verb[place])
        clip = _retimed(self.clips[place], self.augmentation, rng)
        is_mirrored = bool(rng.random() < self.augmentation.mirror_share) and self._may_mirror(verb)
        nodes = clip.nodes_mm @ _turn(self.augmentation, rng).T
        nodes = nodes + self.augmentation.noise_mm * rng.normal(size=nodes.shape)
        clip = replace(clip, nodes_mm=nodes.astype(np.float32))
        if is_mirrored:
            clip, verb = mirrored(clip, self.augmentation.vertical), mirrored_verb(verb, self.verbs)
        sequence = sequence_of(clip, self.config)
        return {
            "poses": sequence.values,
            "is_observed": sequence.observed,
            "is_interpolated": sequence.is_interpolated,
            "verb": verb,
            "noun": int(self.noun[place]),
        }

    def _may_mirror(self, verb: int) -> bool:
        is_cyclic = self.verbs[verb] in CYCLIC_VERBS
        has_other = mirrored_verb(verb, self.verbs) != verb
        return {"off": False, "acyclic": not is_cyclic, "relabel": not is_cyclic or has_other}[
            self.augmentation.mirroring
        ]


def mirrored_verb(verb: int, verbs: tuple[str, ...]) -> int:
    """Return which class the mirror image of a verb shows; a cyclic verb whose counterpart is no class stays."""
    if verbs[verb] not in CYCLIC_VERBS:
        return verb
    other = CYCLIC_VERBS[1 - CYCLIC_VERBS.index(verbs[verb])]
    return verbs.index(other) if other in verbs else verb


def mirrored(clip: PoseClip, vertical: tuple[float, float, float]) -> PoseClip:
    """Return the clip in a mirror that stands upright: the mirror image of a left hand takes the right one's place."""
    across = _horizontal(np.array(vertical))
    reflection = np.eye(3) - 2 * np.outer(across, across)
    return replace(
        clip,
        nodes_mm=(clip.nodes_mm[:, ::-1] @ reflection).astype(np.float32),
        observed=clip.observed[:, ::-1],
        is_interpolated=clip.is_interpolated[:, ::-1],
    )


def _retimed(clip: PoseClip, augmentation: VerbAugmentation, rng: np.random.Generator) -> PoseClip:
    """Return a stretch of a clip at another speed."""
    cut, where, speed = rng.random(), rng.random(), np.exp(augmentation.speed_spread * rng.normal())
    last = len(clip) - 1.0
    kept = last * (1 - augmentation.crop_share * cut)
    first = where * (last - kept)
    if kept == last and speed == 1.0:
        return clip
    return clip.at(np.linspace(first, first + kept, max(2, round(kept / speed) + 1)).clip(0, last))


def _turn(augmentation: VerbAugmentation, rng: np.random.Generator) -> Float64[np.ndarray, "3 3"]:
    """Return a rotation about the vertical."""
    angle = np.deg2rad(augmentation.turn_deg) * rng.uniform(-1.0, 1.0)
    axis = np.array(augmentation.vertical) / np.linalg.norm(augmentation.vertical)
    return np.asarray(cv2.Rodrigues(angle * axis)[0], dtype=np.float64)


def _horizontal(vertical: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """Return a unit vector across the vertical; which one is of no matter, as clips are turned about it."""
    axis = np.eye(3)[np.argmin(np.abs(vertical))]
    across = axis - vertical * (axis @ vertical) / (vertical @ vertical)
    return np.asarray(across / np.linalg.norm(across))
