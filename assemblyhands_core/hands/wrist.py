"""Hands as seen from their own wrist."""

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST


def relative_to_wrist(points_mm: Float[np.ndarray, "row joint 3"]) -> Float[np.ndarray, "row joint 3"]:
    """Return the joints of one hand (21) or both (42) minus their own hand's wrist: the egocentric figures' form.

    The wrist itself becomes 0, and counts as such in the reference's mean (formats 2.8).
    """
    hands = points_mm.reshape(len(points_mm), -1, NUM_JOINTS, 3)
    return np.asarray(hands - hands[:, :, WRIST, None]).reshape(points_mm.shape)
