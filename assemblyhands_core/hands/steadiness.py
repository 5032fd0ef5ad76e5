"""Whether a hand keeps its shape over time: bones do not change their lengths, estimates of them do."""

from typing import Final

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.kinematics import bone_lengths_mm

_SD_OVER_MAD: Final = 1.4826  # of a normal distribution


def robust_sd(values: Float[np.ndarray, " value"]) -> float:
    """Return a robust standard deviation, into which outliers do not enter; NaN of nothing."""
    return _SD_OVER_MAD * float(np.median(np.abs(values - np.median(values)))) if len(values) else float("nan")


def bones_spread_mm(joints_mm: Float[np.ndarray, "instant 21 3"]) -> float:
    """Return how much the bones of one hand vary over time: the mean over its bones of the robust deviation.

    Args:
        joints_mm: In any frame; NaN where unknown. Bones that are never known do not count.

    Returns:
        In mm, NaN if no bone is ever known.
    """
    spreads = [robust_sd(bone[np.isfinite(bone)]) for bone in bone_lengths_mm(joints_mm).T]
    known = [spread for spread in spreads if np.isfinite(spread)]
    return float(np.mean(known)) if known else float("nan")
