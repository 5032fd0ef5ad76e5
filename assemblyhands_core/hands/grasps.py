"""Named ways of holding a hand, as joint angles that blend into one another.

The kinds are those of the usual taxonomies (Napier 1956: power and precision; Feix et al. 2016): a cylinder in the
whole hand, a small thing between two or three pads, a screwdriver with the index finger along the shaft.
"""

from typing import Final, Literal, get_args

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.hands.kinematics import clamp_to_limits

Grasp = Literal["flat", "open", "relaxed", "power", "fist", "pinch", "tripod", "screwdriver"]
GRASPS: Final[tuple[Grasp, ...]] = get_args(Grasp)

# One row a finger, thumb first: abduction, base flexion, middle flexion, distal flexion.
_ANGLES_DEG: Final[dict[Grasp, tuple[tuple[float, float, float, float], ...]]] = {
    "flat": ((-8, -5, 0, 0), (-4, 0, 2, 1), (0, 0, 2, 1), (3, 0, 2, 1), (8, 0, 2, 1)),
    "open": ((12, -15, -5, -5), (8, -5, 5, 2), (1, -3, 5, 2), (-5, -3, 6, 2), (-10, -4, 6, 2)),
    "relaxed": ((5, 5, 12, 15), (2, 20, 28, 12), (0, 25, 33, 15), (0, 28, 36, 16), (-2, 28, 36, 16)),
    "power": ((25, 15, 22, 25), (2, 48, 62, 30), (0, 55, 66, 34), (0, 60, 66, 36), (0, 64, 64, 38)),
    "fist": ((12, 30, 45, 50), (0, 80, 98, 55), (0, 82, 100, 58), (0, 84, 100, 60), (0, 86, 98, 60)),
    "pinch": ((22, 22, 18, 22), (2, 48, 48, 24), (0, 22, 30, 14), (-2, 18, 28, 12), (-6, 15, 26, 12)),
    "tripod": ((24, 25, 15, 20), (3, 48, 48, 22), (2, 54, 52, 26), (0, 55, 70, 35), (0, 58, 72, 38)),
    "screwdriver": ((20, 24, 16, 18), (4, 38, 36, 16), (0, 62, 66, 34), (0, 68, 72, 38), (0, 72, 72, 40)),
}


def grasp_angles_rad(grasp: Grasp) -> Float64[np.ndarray, "20"]:
    """Return the angles of a named grasp in the order of `kinematics.ANGLE_NAMES`; all lie within the limits."""
    return np.deg2rad(_ANGLES_DEG[grasp]).ravel()


def blended_grasps_rad(
    start: Float[np.ndarray, "*batch 20"], end: Float[np.ndarray, "*batch 20"], share: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch 20"]:
    """Return angles part of the way from one grasp to another (share 0: start, 1: end), within the limits."""
    return clamp_to_limits(start + share[..., None] * (end - start))
