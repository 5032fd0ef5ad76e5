"""Mix two estimates of the same joints whose errors have little in common, where they are near each other."""

import numpy as np
from jaxtyping import Float, Float64


def blended_mm(
    joints_mm: Float[np.ndarray, "*any 3"], others_mm: Float[np.ndarray, "*any 3"], share: float, within_mm: float
) -> Float64[np.ndarray, "*any 3"]:
    """Return joints moved towards others by a share of the way, where these are known and near.

    The mean of two equally good estimates with independent errors has 0.7 times their error. Far apart one of them is
    wrong altogether, and half of a gross error is one, too: there the joint stays as it is.

    Args:
        joints_mm: The joints; NaN stays NaN.
        others_mm: The others, NaN where unknown.
        share: How much the others count; 0 leaves all joints as they are.
        within_mm: Joints that are farther than this from the other one stay.
    """
    is_near = np.linalg.norm(joints_mm - others_mm, axis=-1, keepdims=True) <= within_mm
    return np.asarray(np.where(is_near, (1 - share) * joints_mm + share * others_mm, joints_mm), dtype=np.float64)
