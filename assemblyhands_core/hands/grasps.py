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
    "relaxed": ((0, 6, 12, 14), (2, 20, 28, 12), (0, 25, 33, 15), (0, 28, 36, 16), (-2, 28, 36, 16)),
    "power": ((28, -6, 46, 42), (0, 57, 60, 27), (-1, 65, 64, 28), (0, 66, 67, 32), (-2, 58, 71, 30)),
    "fist": ((23, 24, 41, 50), (-3, 78, 94, 52), (-2, 78, 96, 58), (0, 83, 98, 56), (4, 83, 92, 52)),
    "pinch": ((2, 21, 10, 11), (-6, 41, 46, 20), (0, 22, 30, 14), (-2, 18, 28, 12), (-6, 15, 26, 12)),
    "tripod": ((9, 31, 5, 4), (-6, 45, 39, 19), (-1, 55, 43, 10), (2, 60, 66, 35), (2, 64, 68, 38)),
    "screwdriver": ((11, 16, 10, 14), (-5, 42, 36, 14), (0, 64, 60, 32), (0, 70, 68, 36), (0, 74, 70, 38)),
}


def grasp_angles_rad(grasp: Grasp) -> Float64[np.ndarray, "20"]:
    """Return the angles of a named grasp in the order of `kinematics.ANGLE_NAMES`; all lie within the limits."""
    return np.deg2rad(_ANGLES_DEG[grasp]).ravel()


def blended_grasps_rad(
    start: Float[np.ndarray, "*#batch 20"],
    end: Float[np.ndarray, "*#batch 20"],
    share: float | Float[np.ndarray, "*#batch"],
) -> Float[np.ndarray, "... 20"]:
    """Return angles part of the way from one grasp to another (share 0: start, 1: end), within the limits."""
    return clamp_to_limits(start + np.asarray(share)[..., None] * (end - start))
