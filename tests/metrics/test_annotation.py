import numpy as np
import pytest
from error_tables import errors_table

from assemblyhands_core.data.evaluation_tables import EVALUATION
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.metrics.annotation import Cell, Resampling, evaluate_annotation, evaluate_overall

RESAMPLING = Resampling(block_frames=2, num_resamples=200, seed=0)
NAN = float("nan")


def _evaluate(errors: dict[str, np.ndarray], **columns: object) -> dict[tuple[str, str, str, str], Cell]:
    cells = evaluate_annotation(errors_table(errors, **columns), (0.4, 0.6), RESAMPLING)
    return {(cell.table, cell.group, cell.row, cell.metric): cell for cell in cells}


def test_what_is_missing_lowers_coverage_and_pck_but_not_mpjpe() -> None:
    found = _evaluate({"R1": np.array([[10.0, 10.0], [10.0, NAN]])})
    cells = {metric: found["annotation", "", "R1", metric] for metric in ("mpjpe_mm", "pck_auc", "pck_auc_found")}
    assert [cell.value for cell in cells.values()] == pytest.approx([10.0, 0.75 * 50.5, 50.5], abs=0.6)
    assert cells["pck_auc"].value == pytest.approx(0.75 * cells["pck_auc_found"].value)
    assert all(cell.coverage == 75.0 for cell in cells.values())
    assert [cell.n for cell in cells.values()] == [3 * NUM_JOINTS, 4 * NUM_JOINTS, 3 * NUM_JOINTS]
    assert found["annotation", "", "R1", "wrist_relative_mpjpe_mm"].value == 5.0
    assert found["annotation", "", "R1", "pck_20mm"].value == 75.0


def test_groups_of_instants_are_told_apart() -> None:
    values = np.array([[1.0, 3.0], [5.0, 7.0]] * 4)
    found = _evaluate({"m": values}, verbs=("", "screw"), occlusion=(0.4, 0.7))
    mean = {key[:2]: cell.value for key, cell in found.items() if key[3] == "mpjpe_mm"}
    assert mean["annotation", ""] == 4.0
    assert mean["annotation_by_hand", "right"] == 3.0 and mean["annotation_by_hand", "left"] == 5.0
    assert mean["annotation_by_verb", "(between actions)"] == 2.0 and mean["annotation_by_verb", "screw"] == 6.0
    occlusion = {group: value for (table, group), value in mean.items() if table.endswith("occlusion")}
    assert occlusion["middle (0.4 to 0.6)"] == 2.0 and occlusion["high (>= 0.6)"] == 6.0
    assert np.isnan(occlusion["low (< 0.4)"])
    assert found["annotation_by_occlusion", "low (< 0.4)", "m", "mpjpe_mm"].n == 0


def test_groups_of_joints_are_told_apart() -> None:
    values = np.broadcast_to(np.arange(NUM_JOINTS, dtype=float), (3, 2, NUM_JOINTS))
    mean = {key[:2]: cell for key, cell in _evaluate({"m": values}).items() if key[3] == "mpjpe_mm"}
    assert mean["annotation_by_joint", "index_tip"].value == 4.0 and mean["annotation_by_joint", "wrist"].value == 20.0
    assert mean["annotation_by_finger", "middle"].value == pytest.approx((8 + 9 + 10 + 11) / 4)
    assert mean["annotation_by_finger", "wrist"].n == 6 and mean["annotation_by_finger", "thumb"].n == 24


def test_every_line_fits_the_table_and_intervals_hold_the_value() -> None:
    values = np.random.default_rng(0).gamma(2, 3, (30, 2))
    cells = evaluate_annotation(errors_table({"2d_triangulation": values, "R1": values / 2}), (0.4, 0.6), RESAMPLING)
    EVALUATION.from_rows([{"sequence_id": "s", **cell._asdict()} for cell in cells])
    overall = [cell for cell in cells if cell.table == "annotation"]
    assert all(cell.low <= cell.value <= cell.high for cell in overall)
    assert sum(cell.low < cell.value < cell.high for cell in overall) >= 8
    assert evaluate_overall(errors_table({"2d_triangulation": values, "R1": values / 2}), RESAMPLING) == overall


def test_a_few_blocks_have_no_interval() -> None:
    cell = _evaluate({"m": np.array([[1.0, 2.0]] * 8)})["annotation", "", "m", "mpjpe_mm"]
    assert cell.value == 1.5 and np.isnan([cell.low, cell.high]).all()
