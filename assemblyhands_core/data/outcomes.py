"""How well each point of a triangulation came out, as the outcome columns of ``data/columns.py``."""

import numpy as np
from jaxtyping import Shaped

from assemblyhands_core.geometry.triangulation import Triangulation


def outcome_columns(found: Triangulation, num_points: int) -> dict[str, Shaped[np.ndarray, "row {num_points}"]]:
    """Return the columns valid, reason, num_views and reprojection_px, with so many points in a row.

    The reprojection error is the mean over a point's inlier views in pixels, NaN where the point is missing.
    """
    num_views = found.is_inlier.sum(axis=1)
    is_valid = np.asarray(found.status == "ok")
    total_px = np.where(found.is_inlier, found.reprojection_px, 0.0).sum(axis=1)
    mean_px = np.where(is_valid, total_px / np.maximum(num_views, 1), np.nan)
    columns = {
        "valid": is_valid,
        "reason": np.where(is_valid, "", found.status.astype(object)),
        "num_views": num_views,
        "reprojection_px": mean_px,
    }
    return {name: values.reshape(-1, num_points) for name, values in columns.items()}
