"""2D keypoints by hand and view, and how far projected joints are from them."""

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.catalog import KEYPOINTS
from assemblyhands_core.data.keypoint_rows import (
    distances_px,
    hand_codes,
    keypoints_by_view,
    positions,
    rows_of_hands,
)
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole


def _row(frame: int, hand: str, camera_id: str, value: float, valid: bool = True) -> dict[str, object]:
    name = {"sequence_id": "s", "frame": frame, "hand": hand, "camera_id": camera_id, "source": ""}
    confidence = np.linspace(0, 1, 21)
    return name | {"keypoints_px": np.full(42, value), "confidence": confidence, "valid": valid, "reason": ""}


ROWS = KEYPOINTS.from_rows([_row(3, "left", "a", 1.0), _row(3, "right", "b", 2.0), _row(7, "right", "a", 3.0, False)])


def test_codes_rise_with_frame_and_hand_and_find_their_rows() -> None:
    assert hand_codes(ROWS).tolist() == [7, 6, 14]
    assert positions(ROWS["camera_id"], ["b", "c"]).tolist() == [-1, 0, -1]
    assert rows_of_hands(ROWS, ROWS.take([2, 0])).tolist() == [1, -1, 0]


def test_keypoints_stand_where_they_belong_and_weak_ones_are_not_seen() -> None:
    row_hand, row_view = np.array([0, 1, 1]), np.array([0, 1, 0])
    pixels, confidence = keypoints_by_view(ROWS, row_hand, row_view, 2, 2, 0.5)
    is_seen = np.isfinite(pixels).all(axis=-1)
    assert is_seen[0, 0].tolist() == is_seen[1, 1].tolist() == [False] * 10 + [True] * 11
    assert not is_seen[0, 1].any() and not is_seen[1, 0].any()  # no row, and one that is not valid
    assert set(pixels[0, 0, 10:].ravel()) == {1.0} and set(pixels[1, 1, 10:].ravel()) == {2.0}
    np.testing.assert_array_equal(confidence > 0, is_seen)
    pixels, _ = keypoints_by_view(ROWS, np.array([-1, 0, 0]), row_view, 1, 2, 0.0)
    assert np.isfinite(pixels).all(axis=-1).sum() == 20  # none with confidence 0


def test_distances_are_in_pixels_and_unknown_where_either_is() -> None:
    camera = Camera("a", 64, 48, 100.0, 100.0, 32.0, 24.0, Pinhole(), np.eye(4))
    joints = np.tile([0.0, 0.0, 1000.0], (2, 21, 1))
    joints[1, 0] = np.nan
    pixels = np.tile([35.0, 28.0], (2, 1, 21, 1))
    pixels[0, 0, 1] = np.nan
    found = distances_px(joints, [camera], pixels)
    assert found.shape == (2, 1, 21) and np.nanmax(found) == np.nanmin(found) == 5.0
    assert np.argwhere(np.isnan(found)).tolist() == [[0, 0, 1], [1, 0, 0]]
    assert distances_px(joints, [], np.empty((2, 0, 21, 2))).shape == (2, 0, 21)


def test_no_rows() -> None:
    none: pa.Table = KEYPOINTS.empty()
    empty = np.empty(0, dtype=np.int64)
    assert np.isnan(keypoints_by_view(none, empty, empty, 1, 1, 0.0)[0]).all()
    assert rows_of_hands(none, ROWS).tolist() == []
