"""Predictions that are off by known amounts, in another order than their crops."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from ego_crops import ego_crops, hands

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.ego_tables import EGO_CROPS, EGO_HANDS
from assemblyhands_core.data.evaluation_tables import EGO_ERRORS
from assemblyhands_core.hands.joints import HANDS, WRIST
from stages._contract import Context, StageConfig
from stages.evaluate_ego import STAGE
from stages.tabulate_ego import STAGE as TABULATE
from stages.tabulate_ego import TabulateEgoConfig

CONFIG = TabulateEgoConfig(block_frames=2, num_resamples=100, seed=0)


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


def _errors(crops: pa.Table, shift_mm: np.ndarray, **changes: Any) -> pa.Table:
    inputs = {"crops": crops, "hands": _predicted(crops, shift_mm, **changes)}
    return STAGE.run(StageConfig(), inputs, Context(Path(), "s"))["errors"]


def _tabulated(manual: pa.Table, automatic: pa.Table, splits: dict[str, str]) -> dict[tuple[str, ...], dict[str, Any]]:
    members = MEMBERS.from_rows([{"sequence_id": name, "split": split} for name, split in splits.items()])
    inputs = {"members": members, "manual": manual, "automatic": automatic}
    rows = TABULATE.run(CONFIG, inputs, Context(Path(), "all"))["metrics"].to_pylist()
    return {tuple(row[name] for name in ("table", "group", "row", "metric")): row for row in rows}


def test_errors_are_from_wrist_to_wrist_of_labelled_joints() -> None:
    crops = ego_crops(8)
    errors = _errors(crops, np.array([3.0, 0.0, 4.0]))
    assert errors.num_rows == 7 and errors["frame"].to_pylist() == [0, 1, 2, 4, 5, 6, 7]
    error_mm, labelled = to_numpy(errors["error_mm"]), to_numpy(errors["is_labelled"]).astype(bool)
    assert labelled.mean() > 0.8 and np.array_equal(np.isfinite(error_mm), labelled)
    np.testing.assert_allclose(error_mm[:, WRIST], 0.0, atol=1e-3)
    others = labelled & (np.arange(21) != WRIST)
    np.testing.assert_allclose(error_mm[others], 5.0, atol=1e-3)
    assert errors["is_identity_right"].to_pylist() == [True, False, True, False, False, True, False]
    metrics = _tabulated(errors, EGO_ERRORS.empty(), {"s": "test"})
    expected = 5.0 * others.sum() / labelled.sum()
    assert metrics["ego", "", "manual", "wrist_relative_mpjpe_mm"]["value"] == pytest.approx(expected, abs=1e-3)
    assert metrics["ego", "", "manual", "identity_accuracy"]["value"] == pytest.approx(100 * 3 / 7)


def test_a_hand_that_was_not_found_lowers_coverage() -> None:
    errors = _errors(ego_crops(6), np.zeros(3), lost=2)
    rows = {row["frame"]: row for row in errors.to_pylist()}
    assert np.isnan(rows[2]["error_mm"]).all() and any(rows[2]["is_labelled"])
    metrics = _tabulated(errors, EGO_ERRORS.empty(), {"s": ""})
    assert 70.0 < metrics["ego", "", "manual", "coverage"]["value"] < 90.0
    assert metrics["ego", "", "manual", "wrist_relative_mpjpe_mm"]["value"] == pytest.approx(0.0, abs=1e-3)


def test_sequences_that_were_learnt_from_do_not_count_and_both_kinds_of_labels_make_a_third_row() -> None:
    def of(sequence_id: str, source: str, shift_mm: float) -> pa.Table:
        rows = [row | {"sequence_id": sequence_id, "source": source} for row in ego_crops(6).to_pylist()]
        return _errors(EGO_CROPS.from_rows(rows), np.array([shift_mm, 0.0, 0.0]))

    manual = pa.concat_tables([of("a", "manual", 40.0), of("b", "manual", 2.0)])
    automatic = pa.concat_tables([of("a", "mvexonet", 40.0), of("b", "mvexonet", 4.0)])
    assert set(automatic["labels"].to_pylist()) == {"automatic"}
    metrics = _tabulated(manual, automatic, {"a": "train", "b": "test"})
    found = [metrics["ego", "", row, "wrist_relative_mpjpe_mm"]["value"] for row in ("manual", "automatic", "both")]
    assert found[1] == pytest.approx(2 * found[0]) and found[2] == pytest.approx(1.5 * found[0])
    assert found[0] == pytest.approx(2.0 * 20 / 21, rel=0.05)
    assert len(_tabulated(manual, automatic, {"a": "train", "b": "train"})) == len(metrics), "better all than none"


def test_nothing_gives_empty_tables() -> None:
    empty = {name: spec.empty() for name, spec in STAGE.inputs.items()}
    errors = STAGE.run(StageConfig(), empty, Context(Path(), "s"))["errors"]
    assert errors.num_rows == 0 and not _tabulated(errors, errors, {})
