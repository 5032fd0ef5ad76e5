"""Rows of 2D keypoints brought into arrays by hand and view."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float, Float64, Int64

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS


def hand_codes(table: pa.Table) -> Int64[np.ndarray, " row"]:
    """Return one number for the hand and instant of each row, ascending by frame, right before left."""
    return np.asarray(to_numpy(table["frame"]) * len(HANDS) + positions(table["hand"], HANDS), dtype=np.int64)


def rows_of_hands(table: pa.Table, hands: pa.Table) -> Int64[np.ndarray, " row"]:
    """Return in which row of another table, which has each hand and instant once, each row's is; -1 in none."""
    places = {code: row for row, code in enumerate(hand_codes(hands).tolist())}
    return np.array([places.get(code, -1) for code in hand_codes(table).tolist()], dtype=np.int64)


def positions(column: pa.ChunkedArray, values: Sequence[str]) -> Int64[np.ndarray, " row"]:
    """Return where each entry of a column stands among the values, -1 where it does not."""
    return np.asarray(pc.index_in(column, pa.array(values, pa.string())).fill_null(-1), dtype=np.int64)


def keypoints_by_view(
    keypoints: pa.Table,
    row_hand: Int64[np.ndarray, " row"],
    row_view: Int64[np.ndarray, " row"],
    num_hands: int,
    num_views: int,
    min_confidence: float,
) -> tuple[Float64[np.ndarray, "hand view joint=21 2"], Float64[np.ndarray, "hand view joint=21"]]:
    """Spread a `catalog.KEYPOINTS` table over hands and views.

    Args:
        keypoints: Rows that are not valid are not used.
        row_hand, row_view: Place of each row, -1 where it has none.
        num_hands, num_views: How many places there are.
        min_confidence: Keypoints below are as good as not seen.

    Returns:
        Pixels, NaN where a view did not see the joint well enough, and confidence, 0 there.
    """
    pixels = np.full((num_hands, num_views, NUM_JOINTS, 2), np.nan)
    confidence = np.zeros(pixels.shape[:-1])
    is_used = to_numpy(keypoints["valid"]).astype(bool) & (row_view >= 0) & (row_hand >= 0)
    place = row_hand[is_used], row_view[is_used]
    pixels[place] = to_numpy(keypoints["keypoints_px"])[is_used].reshape(-1, NUM_JOINTS, 2)
    confidence[place] = to_numpy(keypoints["confidence"])[is_used]
    is_seen = np.isfinite(pixels).all(axis=-1) & (confidence >= min_confidence) & (confidence > 0)
    pixels[~is_seen], confidence[~is_seen] = np.nan, 0.0
    return pixels, confidence


def distances_px(
    joints_world_mm: Float[np.ndarray, "hand joint=21 3"],
    cameras: Sequence[Camera],
    pixels: Float[np.ndarray, "hand view joint=21 2"],
) -> Float64[np.ndarray, "hand view joint=21"]:
    """Return how far projected joints are from 2D keypoints, NaN where either is unknown."""
    projected = [camera.project(joints_world_mm.astype(np.float64)) for camera in cameras]
    by_view = [np.linalg.norm(seen - pixels[:, view], axis=-1) for view, seen in enumerate(projected)]
    return np.stack(by_view, axis=1) if by_view else np.empty((len(pixels), 0, NUM_JOINTS))
