from pathlib import Path

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.ground_truth import TrueInstant, ground_truth_tables, write_ground_truth
from assemblyhands_core.viz.joint_layers import TRUTH, joint_layer, layer_color, true_layer

FRAMES = np.array([2, 4, 6])
HAND = np.arange(63.0).reshape(21, 3)


def _row(frame: int, hand: str, points: np.ndarray, num_valid: int = 21) -> dict[str, object]:
    return {
        "sequence_id": "monday",
        "frame": frame,
        "hand": hand,
        "joints_world_mm": points.ravel(),
        "valid": np.arange(21) < num_valid,
        "reason": [""] * 21,
        "num_views": [4] * 21,
        "reprojection_px": np.full(21, float(frame)),
        "source": "mvexonet",
        "round": 1,
    }


def _table() -> pa.Table:
    rows = [
        _row(4, "right", HAND),
        _row(4, "left", HAND + 100, num_valid=5),
        _row(5, "left", HAND),
        _row(9, "left", HAND),
    ]
    return JOINTS.from_rows(rows)


def test_rows_are_spread_over_frames_and_hands() -> None:
    layer = joint_layer("round_1", _table(), FRAMES, (1, 2, 3))
    assert layer.joints_world_mm.shape == (3, 2, 21, 3)
    np.testing.assert_array_equal(layer.joints_world_mm[1, 0], HAND)
    np.testing.assert_array_equal(layer.joints_world_mm[1, 1, :5], HAND[:5] + 100)
    is_known = np.isfinite(layer.joints_world_mm).all(axis=-1).sum(axis=-1)
    assert is_known.tolist() == [[0, 0], [21, 5], [0, 0]]  # frame 5 is between those that are shown, 9 after them
    np.testing.assert_array_equal(layer.mean_reprojection_px()[1], [4.0, 4.0])
    assert np.isnan(layer.mean_reprojection_px()[[0, 2]]).all()


def test_no_frames_or_no_rows_are_no_joints() -> None:
    empty = np.empty(0, np.int64)
    assert joint_layer("round_1", _table(), empty, (1, 2, 3)).joints_world_mm.shape == (0, 2, 21, 3)
    assert np.isnan(joint_layer("round_1", JOINTS.empty(), FRAMES, (1, 2, 3)).joints_world_mm).all()


def test_errors_are_of_the_joints_that_both_have(tmp_path: Path) -> None:
    true = np.stack([HAND + np.array([0, 0, 3.0]), HAND + 100])
    instants = [TrueInstant(frame, true, {}, {}) for frame in range(5)]
    write_ground_truth(tmp_path, ground_truth_tables("monday", instants))
    truth = true_layer(tmp_path, FRAMES)
    assert truth.name == TRUTH and np.isnan(truth.joints_world_mm[2]).all()
    np.testing.assert_array_equal(truth.joints_world_mm[1], true)
    errors = joint_layer("round_1", _table(), FRAMES, (1, 2, 3)).mean_error_mm(truth)
    np.testing.assert_allclose(errors[1], [3.0, 0.0])
    assert np.isnan(errors[[0, 2]]).all() and np.isnan(truth.mean_reprojection_px()).all()


def test_colours_come_again_after_the_last() -> None:
    assert len({layer_color(number) for number in range(5)}) == 5 and layer_color(5) == layer_color(0)
