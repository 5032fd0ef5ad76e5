import numpy as np
import pyarrow as pa
import pytest
from error_tables import ego_errors_table

from assemblyhands_core.data.evaluation_tables import EGO_ERRORS, EVALUATION
from assemblyhands_core.metrics.annotation import Cell, Resampling
from assemblyhands_core.metrics.egocentric import by_labels, egocentric_differences, evaluate_egocentric

RESAMPLING = Resampling(block_frames=2, num_resamples=200, seed=0)


def _evaluate(errors: pa.Table) -> dict[tuple[str, str, str, str], Cell]:
    return {(c.table, c.group, c.row, c.metric): c for c in evaluate_egocentric(errors, RESAMPLING)}


def test_figures_by_hand() -> None:
    found = _evaluate(ego_errors_table())
    whole = {
        metric: found["ego", "", "manual", metric] for metric in ("wrist_relative_mpjpe_mm", "pck_auc", "coverage")
    }
    assert whole["wrist_relative_mpjpe_mm"].value == pytest.approx(4.0 * 20 / 21)  # 1 to 7 mm; the wrist counts as 0
    assert whole["wrist_relative_mpjpe_mm"].n == 7 * 21 and whole["coverage"].value == pytest.approx(87.5)
    shares = [1 - e / 20 for e in range(1, 8)]
    assert whole["pck_auc"].value == pytest.approx(
        100 * (20 * sum(shares) + 7) / (21 * 8), abs=0.6
    )  # errors lie on thresholds
    assert found["ego", "", "manual", "identity_accuracy"].value == 75.0
    assert found["ego", "", "manual", "identity_accuracy"].n == 8
    toolkit = found["ego", "", "manual", "toolkit_mpjpe_mm"]  # the right hand's joints are 4 mm off, the left one's too
    assert toolkit.value == pytest.approx(4.0 * 20 / 21) and toolkit.n == 7 * 21


def test_groups_are_told_apart_and_every_line_fits_the_table() -> None:
    found = _evaluate(ego_errors_table())
    mean = {key[:2]: cell.value * 21 / 20 for key, cell in found.items() if key[3] == "wrist_relative_mpjpe_mm"}
    assert mean["ego_by_camera", "a"] == pytest.approx(2.5) and mean["ego_by_camera", "b"] == pytest.approx(6.0)
    assert mean["ego_by_hand", "right"] == pytest.approx(4.0)
    assert mean["ego_by_verb", "screw"] == pytest.approx(1.5)
    assert mean["ego_by_border", "near (< 20 px)"] == pytest.approx(1.0)
    assert mean["ego_by_border", "middle (20 to 80 px)"] == pytest.approx(3.0)
    EVALUATION.from_rows([{"sequence_id": "s", **cell._asdict()} for cell in found.values()])
    assert all(np.isnan(c.low) or c.low <= c.value <= c.high for c in found.values())


def test_labels_are_not_mixed_and_nothing_gives_nothing() -> None:
    automatic = ego_errors_table().set_column(4, "labels", pa.array(["automatic"] * 8))
    both = pa.concat_tables([ego_errors_table(), automatic.cast(ego_errors_table().schema)])
    rows = {cell.row for cell in evaluate_egocentric(both, RESAMPLING)}
    assert rows == {"manual", "automatic", "both"} and evaluate_egocentric(EGO_ERRORS.empty(), RESAMPLING) == []


def _worse(errors: pa.Table, by_mm: np.ndarray) -> pa.Table:
    """Return the same crops with all joints but the wrist so many millimetres further off, and all identities right."""
    rows = [
        {
            **row,
            "error_mm": [mm + extra for mm in row["error_mm"][:20]] + row["error_mm"][20:],
            "is_identity_right": True,
        }
        for row, extra in zip(errors.to_pylist(), by_mm.tolist(), strict=True)
    ]
    return EGO_ERRORS.from_rows(rows)


def test_two_runs_differ_by_what_was_put_in() -> None:
    """Blocks of two frames, of which the last one has a crop that was not found; all are a millimetre further off."""
    first = ego_errors_table(12)
    found = {
        (d.table, d.group, d.metric): d for d in egocentric_differences(first, _worse(first, np.ones(12)), RESAMPLING)
    }
    whole = found["ego", "", "wrist_relative_mpjpe_mm"]
    assert [whole.value, whole.low, whole.high] == pytest.approx([-20 / 21] * 3)  # the wrists stay where they are
    assert (whole.first, whole.n) == (pytest.approx(6 * 20 / 21), 11 * 21)
    assert whole.second == pytest.approx(7 * 20 / 21)
    assert found["ego", "", "pck_auc"].low > 0 and found["ego", "", "coverage"].value == 0
    identity = found["ego", "", "identity_accuracy"]  # 3 of 12 were wrong: one in every second block of two crops
    assert (identity.first, identity.second, identity.value) == (75.0, 100.0, -25.0)
    assert -50 < identity.low < -25 < identity.high < 0
    by_camera = found["ego_by_camera", "a", "wrist_relative_mpjpe_mm"]
    assert by_camera.value == pytest.approx(-20 / 21) and np.isnan(by_camera.low), "three blocks say too little"


def test_what_is_hard_for_both_runs_cancels() -> None:
    first = ego_errors_table(40)
    extra = np.tile([0.5, 1.5], 20)  # each block of two frames is a millimetre worse in the mean
    (difference,) = (
        d
        for d in egocentric_differences(first, _worse(first, extra), RESAMPLING)
        if (d.table, d.metric) == ("ego", "wrist_relative_mpjpe_mm")
    )
    own = _evaluate(first)["ego", "", "manual", "wrist_relative_mpjpe_mm"]
    assert own.high - own.low > 4 and difference.high - difference.low < 0.2
    assert difference.low < difference.value < difference.high < 0


def test_kinds_of_labels_stand_alone_and_together() -> None:
    automatic = ego_errors_table().set_column(4, "labels", pa.array(["automatic"] * 8))
    both = pa.concat_tables([ego_errors_table(), automatic.cast(ego_errors_table().schema)])
    assert [(name, rows.num_rows) for name, rows in by_labels(both)] == [("automatic", 8), ("manual", 8), ("both", 16)]
    assert [name for name, _ in by_labels(ego_errors_table())] == ["manual"]
