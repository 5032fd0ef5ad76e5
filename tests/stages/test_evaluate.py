from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError
from true_hands import NUM_FRAMES, TRUE_MM, write_truth

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS, JOINTS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, WRIST
from stages._contract import Context, Tables
from stages.evaluate import STAGE, EvaluateConfig

CONFIG = EvaluateConfig(low_occlusion=0.4, high_occlusion=0.6, block_frames=2, num_resamples=100, seed=0)


def _joints(points: np.ndarray, number: int = 0, first_frame: int = 0, **changes: object) -> pa.Table:
    count = len(points) * 2
    valid = np.isfinite(points).all(axis=-1).reshape(count, NUM_JOINTS)
    columns = {
        "sequence_id": ["s"] * count,
        "frame": np.repeat(np.arange(len(points)), 2) + first_frame,
        "hand": list(HANDS) * len(points),
        "joints_world_mm": points.reshape(count, -1),
        "valid": valid,
        "reason": np.where(valid, "", "too_few_views").astype(object),
        "num_views": np.full((count, NUM_JOINTS), 4),
        "reprojection_px": np.zeros((count, NUM_JOINTS)),
        "source": ["mvexonet" if number else "2d_triangulation"] * count,
        "round": [number] * count,
    }
    return JOINTS.build({**columns, **changes})


def _run(folder: Path, joints: pa.Table, truth: pa.Table | None = None, num_frames: int = NUM_FRAMES) -> Tables:
    truth = write_truth(folder) if truth is None else truth
    chunk = {"sequence_id": "s", "chunk": 0, "first_frame": 0, "num_frames": num_frames}
    inputs = {"chunks": CHUNKS.from_rows([chunk]), "truth": truth, "joints": joints}
    return STAGE.run(CONFIG, inputs, Context(folder, "s"))


def _value(made: Tables, table: str, group: str, metric: str) -> float:
    rows = made["metrics"].to_pylist()
    (row,) = [r for r in rows if (r["table"], r["group"], r["metric"]) == (table, group, metric)]
    return float(row["value"])


def test_errors_and_figures_of_joints_that_are_off_by_known_amounts(tmp_path: Path) -> None:
    points = TRUE_MM + np.float32([3.0, 0, 0])
    points[:, 1] += np.float32([0, 4.0, 0])
    made = _run(tmp_path, _joints(points))
    error_mm = to_numpy(made["errors"]["error_mm"])
    assert np.allclose(error_mm[::2], 3.0, atol=1e-4) and np.allclose(error_mm[1::2], 5.0, atol=1e-4)
    assert np.allclose(to_numpy(made["errors"]["wrist_relative_error_mm"]), 0.0, atol=1e-4)
    assert _value(made, "annotation", "", "mpjpe_mm") == pytest.approx(4.0, abs=1e-4)
    assert _value(made, "annotation_by_hand", "left", "mpjpe_mm") == pytest.approx(5.0, abs=1e-4)
    assert set(made["metrics"]["row"].to_pylist()) == {"2d_triangulation"}
    assert {"screw", "(between actions)"} <= set(made["metrics"]["group"].to_pylist())


def test_joints_that_are_not_valid_and_hands_without_a_row_are_missing(tmp_path: Path) -> None:
    points = TRUE_MM.copy()
    points[0, 0, WRIST] = np.nan
    made = _run(tmp_path, _joints(points[:6]))
    error_mm = to_numpy(made["errors"]["error_mm"])
    assert made["errors"].num_rows == 2 * NUM_FRAMES and np.isnan(error_mm[12:]).all()
    assert np.isnan(error_mm[0, WRIST]) and np.isfinite(error_mm[0, :WRIST]).all()
    assert np.isnan(to_numpy(made["errors"]["wrist_relative_error_mm"])[0]).all()
    share = 100 * (12 * NUM_JOINTS - 1) / (24 * NUM_JOINTS)
    assert _value(made, "annotation", "", "coverage") == pytest.approx(share)
    assert _value(made, "annotation", "", "pck_auc") == pytest.approx(share, abs=0.3)
    assert _value(made, "annotation", "", "mpjpe_mm") == pytest.approx(0.0, abs=1e-4)


def test_a_value_that_is_not_valid_does_not_count(tmp_path: Path) -> None:
    valid = np.zeros((2 * NUM_FRAMES, NUM_JOINTS), dtype=bool)
    made = _run(tmp_path, _joints(TRUE_MM, valid=valid))
    assert np.isnan(to_numpy(made["errors"]["error_mm"])).all()
    assert _value(made, "annotation", "", "coverage") == 0.0 == _value(made, "annotation", "", "pck_auc")


def test_a_round_is_called_by_its_number_even_where_it_kept_an_earlier_one(tmp_path: Path) -> None:
    kept = ["kept_round_0", *["mvexonet"] * (2 * NUM_FRAMES - 1)]
    made = _run(tmp_path, _joints(TRUE_MM, 2, source=kept))
    assert set(made["errors"]["method"].to_pylist()) == {"R2"} == set(made["metrics"]["row"].to_pylist())
    assert made["errors"]["is_own"].to_pylist() == [False] + [True] * (2 * NUM_FRAMES - 1)
    assert _value(made, "annotation", "", "own") == pytest.approx(100 * (1 - 1 / (2 * NUM_FRAMES)))


def test_smoothed_joints_are_a_method_of_their_own(tmp_path: Path) -> None:
    made = _run(tmp_path, _joints(TRUE_MM, 3, source=["smoothed"] * 2 * NUM_FRAMES))
    assert set(made["errors"]["method"].to_pylist()) == {"R3, smoothed"}


def test_frames_that_nobody_was_to_look_at_are_not_missing(tmp_path: Path) -> None:
    made = _run(tmp_path, _joints(TRUE_MM[:5]), num_frames=5)
    assert made["errors"].num_rows == 10 and _value(made, "annotation", "", "coverage") == 100.0


def test_an_upper_bound_that_found_nothing_itself_still_counts(tmp_path: Path) -> None:
    made = _run(tmp_path, _joints(TRUE_MM, 101, source=["kept_round_100"] * 2 * NUM_FRAMES))
    assert set(made["metrics"]["row"].to_pylist()) == {"true crops and root"}
    assert _value(made, "annotation", "", "coverage") == 0.0 == _value(made, "annotation", "", "pck_auc")


def test_without_any_joints_there_are_no_figures(tmp_path: Path) -> None:
    made = _run(tmp_path, JOINTS.empty())
    assert made["errors"].num_rows == 0 == made["metrics"].num_rows


def test_joints_without_truth_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="frame 12: the right hand has joints but no truth, like 4 rows in all"):
        _run(tmp_path, _joints(TRUE_MM, first_frame=2))


def test_the_truth_of_another_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds the truth of other instead of s"):
        _run(tmp_path, _joints(TRUE_MM), write_truth(tmp_path, "other"))
    with pytest.raises(ValueError, match="4 true hands have no true instant"):
        _run(tmp_path, _joints(TRUE_MM), write_truth(tmp_path, frames=NUM_FRAMES - 2))


def test_bounds_of_occlusion_are_in_order() -> None:
    with pytest.raises(ValidationError, match="has to be below high_occlusion"):
        EvaluateConfig(low_occlusion=0.6, high_occlusion=0.4, block_frames=2, num_resamples=100, seed=0)


def test_a_round_from_the_truth_is_the_upper_bound_and_what_it_kept_from_the_truth_is_missing(tmp_path: Path) -> None:
    sources = ["kept_round_100", *["mvexonet"] * (2 * NUM_FRAMES - 1)]
    made = _run(tmp_path, _joints(TRUE_MM + np.float32([0, 2.0, 0]), 101, source=sources))
    assert set(made["metrics"]["row"].to_pylist()) == {"true crops and root"}
    assert _value(made, "annotation", "", "mpjpe_mm") == pytest.approx(2.0, abs=1e-4)
    assert np.isnan(to_numpy(made["errors"]["error_mm"])).sum() == NUM_JOINTS
