"""Predictions that are off by known amounts, in another order than their crops."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from ego_crops import ego_crops, hands

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import EGO_CROPS, EGO_HANDS
from assemblyhands_core.hands.joints import HANDS, WRIST
from stages._contract import Context, Tables
from stages.evaluate_ego import STAGE, EvaluateEgoConfig

CONFIG = EvaluateEgoConfig(block_frames=2, num_resamples=100, seed=0)


def _predicted(crops: pa.Table, shift_mm: np.ndarray, lost: int = -1) -> pa.Table:
    """Every joint but the wrist is shifted, the whole hand moved by a decimetre; the frame that is lost has none."""
    rows: list[dict[str, Any]] = []
    for crop in crops.to_pylist():
        joints = hands(crop["frame"])[HANDS.index(crop["hand"])] + [100.0, 0.0, 0.0]
        joints[np.arange(21) != WRIST] += shift_mm
        is_valid = crop["valid"] and crop["frame"] != lost
        rows.append(
            {
                **{name: crop[name] for name in EGO_CROPS.key},
                "joints_px": np.zeros(42),
                "depth_mm": np.zeros(21),
                "confidence": np.ones(21),
                "joints_camera_mm": joints.ravel(),
                "joints_world_mm": joints.ravel(),
                "wrist_depth_mm": joints[WRIST, 2],
                "wrist_depth_source": "label",
                "identity": "right",
                "identity_probability": [1.0, 0.0, 0.0],
                "valid": is_valid,
                "reason": "" if is_valid else "low_confidence",
            }
        )
    return EGO_HANDS.from_rows(rows[::-1])


def _run(manual: pa.Table, shift_mm: np.ndarray, **changes: Any) -> Tables:
    inputs = {"manual_crops": manual, "manual_hands": _predicted(manual, shift_mm, **changes)}
    inputs |= {"automatic_crops": EGO_CROPS.empty(), "automatic_hands": EGO_HANDS.empty()}
    return STAGE.run(CONFIG, inputs, Context(Path(), "s"))


def test_errors_are_from_wrist_to_wrist_of_labelled_joints() -> None:
    crops = ego_crops(8)
    made = _run(crops, np.array([3.0, 0.0, 4.0]))
    errors = made["errors"]
    assert errors.num_rows == 7 and errors["frame"].to_pylist() == [0, 1, 2, 4, 5, 6, 7]
    error_mm, labelled = to_numpy(errors["error_mm"]), to_numpy(errors["is_labelled"]).astype(bool)
    assert labelled.mean() > 0.8 and np.array_equal(np.isfinite(error_mm), labelled)
    np.testing.assert_allclose(error_mm[:, WRIST], 0.0, atol=1e-3)
    others = labelled & (np.arange(21) != WRIST)
    np.testing.assert_allclose(error_mm[others], 5.0, atol=1e-3)
    assert errors["is_identity_right"].to_pylist() == [True, False, True, False, False, True, False]
    metrics = {(r["table"], r["group"], r["metric"]): r["value"] for r in made["metrics"].to_pylist()}
    expected = 5.0 * others.sum() / labelled.sum()
    assert metrics["ego", "", "wrist_relative_mpjpe_mm"] == pytest.approx(expected, abs=1e-3)
    assert metrics["ego", "", "identity_accuracy"] == pytest.approx(100 * 3 / 7)


def test_a_hand_that_was_not_found_lowers_coverage() -> None:
    made = _run(ego_crops(6), np.zeros(3), lost=2)
    rows = {row["frame"]: row for row in made["errors"].to_pylist()}
    assert np.isnan(rows[2]["error_mm"]).all() and any(rows[2]["is_labelled"])
    metrics = {(r["table"], r["group"], r["metric"]): r for r in made["metrics"].to_pylist()}
    assert 70.0 < metrics["ego", "", "coverage"]["value"] < 90.0
    assert metrics["ego", "", "wrist_relative_mpjpe_mm"]["value"] == pytest.approx(0.0, abs=1e-3)


def test_nothing_gives_empty_tables() -> None:
    empty = {name: spec.empty() for name, spec in STAGE.inputs.items()}
    made = STAGE.run(CONFIG, empty, Context(Path(), "s"))
    assert made["errors"].num_rows == 0 == made["metrics"].num_rows
