"""Fill short gaps in trajectories."""

import numpy as np
from jaxtyping import Bool, Float


def fill_gaps(
    points: Float[np.ndarray, "frame track axis"], max_gap: int
) -> tuple[Float[np.ndarray, "frame track axis"], Bool[np.ndarray, "frame track"]]:
    """Fill gaps of at most ``max_gap`` frames linearly between the points on both sides.

    Args:
        points: trajectories over consecutive frames; NaN = missing. Ends are never extrapolated.
        max_gap: longest run of missing frames that is filled; longer ones stay wholly missing.

    Returns:
        The trajectories with gaps filled, and which points were filled.
    """
    is_known = np.isfinite(points).all(axis=-1)
    frame = np.arange(len(points))[:, None]
    before = np.maximum.accumulate(np.where(is_known, frame, -1), axis=0)
    after = np.minimum.accumulate(np.where(is_known, frame, len(points))[::-1], axis=0)[::-1]
    is_filled = ~is_known & (before >= 0) & (after < len(points)) & (after - before - 1 <= max_gap)
    track = np.broadcast_to(np.arange(points.shape[1]), before.shape)
    start, end = points[np.maximum(before, 0), track], points[np.minimum(after, len(points) - 1), track]
    share = (frame - before) / np.maximum(after - before, 1)
    return np.where(is_filled[..., None], start + share[..., None] * (end - start), points), is_filled
