"""Triangulated joints that cannot be part of their hand."""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool

from assemblyhands_core.geometry.triangulation import Triangulation
from assemblyhands_core.hands.joints import NUM_JOINTS

OUTSIDE_HAND: Final = "outside_hand"
"""The status of such a joint."""


def without_strays(
    found: Triangulation, max_span_mm: float, is_held: Bool[np.ndarray, "hand joint=21"] | None = None
) -> Triangulation:
    """Take back joints that lie farther than that from the middle of their hand, the median of its joints.

    Views from nearly opposite sides agree on almost anything along the line between them, however far off.

    Args:
        found: Of whole hands, one after the other.
        max_span_mm: The farthest that is believed.
        is_held: Joints that people set, which are believed anyway.
    """
    points = found.points_world_mm.reshape(-1, NUM_JOINTS, 3)
    middle = np.full((len(points), 1, 3), np.nan)
    has_any = np.isfinite(points).any(axis=(1, 2))
    middle[has_any] = np.nanmedian(points[has_any], axis=1, keepdims=True)
    is_far = np.linalg.norm(points - middle, axis=-1) > max_span_mm
    is_stray = np.asarray(is_far if is_held is None else is_far & ~is_held).ravel()
    return replace(
        found,
        points_world_mm=np.where(is_stray[:, None], np.nan, found.points_world_mm),
        status=np.where(is_stray, OUTSIDE_HAND, found.status),
    )
