"""What distinguishes one subject's hands: size, proportions, thickness and skin."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.hands.kinematics import AVERAGE_HAND_LENGTH_MM, HandSkeleton
from assemblyhands_core.synthetic.hand_colour import SkinTone

# Hand length of adults, women and men together: surveys find 165-185 mm in most women and 180-205 mm in most men.
_LENGTH_SPREAD_MM: Final = 10.0
_LENGTH_RANGE_MM: Final = (166.0, 208.0)
_PROPORTION_SPREAD: Final = 0.025
# Longer hands are a little more slender: thickness grows with this power of the length.
_GIRTH_POWER: Final = 0.8
_GIRTH_SPREAD: Final = 0.05
_GIRTH_RANGE: Final = (0.88, 1.12)


@dataclass(frozen=True, eq=False)
class HandShape:
    """A subject's hand; both hands of a subject are mirror images.

    Attributes:
        skeleton: Bone lengths.
        palm_scale: Width, length and depth of the palm over those of the average hand.
        girth_scale: Thickness of each finger over that of the average hand.
        tone: Colour of the skin.
    """

    skeleton: HandSkeleton
    palm_scale: Float64[np.ndarray, "3"]
    girth_scale: Float64[np.ndarray, "5"]
    tone: SkinTone

    @classmethod
    def from_seed(cls, seed: int) -> Self:
        """Draw a subject; the same seed gives the same bytes."""
        generator = np.random.default_rng([seed, 0x4A4D])
        length = np.clip(generator.normal(AVERAGE_HAND_LENGTH_MM, _LENGTH_SPREAD_MM), *_LENGTH_RANGE_MM)
        size = float(length) / AVERAGE_HAND_LENGTH_MM
        # A slender or a sturdy hand is so as a whole; single bones deviate less.
        girth = size**_GIRTH_POWER * float(np.clip(generator.normal(1.0, _GIRTH_SPREAD), *_GIRTH_RANGE))
        finger_to_palm = generator.normal(1.0, _PROPORTION_SPREAD)
        bones = 1.0 + _PROPORTION_SPREAD * np.clip(generator.normal(size=(5, 3)), -2.0, 2.0)
        palm_scale = np.array([0.5 * (size + girth), size / finger_to_palm, girth])
        average = HandSkeleton.average()
        skeleton = HandSkeleton(
            average.bases_mm * palm_scale,
            average.phalanges_mm * size * finger_to_palm * bones,
            average.wrist_from_finger,
        )
        fingers = girth * (1.0 + 0.015 * np.clip(generator.normal(size=5), -2.0, 2.0))
        return cls(skeleton, palm_scale, fingers, _tone(generator))

    @classmethod
    def average(cls) -> Self:
        """Return the hand from which all others are adapted."""
        return cls(HandSkeleton.average(), np.ones(3), np.ones(5), SkinTone(0.3, 1.0, 0))


def _tone(generator: np.random.Generator) -> SkinTone:
    return SkinTone(
        darkness=float(generator.uniform(0.0, 1.0)),
        redness=float(np.clip(generator.normal(1.0, 0.25), 0.4, 1.6)),
        mottle_seed=int(generator.integers(2**31)),
    )
