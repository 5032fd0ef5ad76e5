import numpy as np
import pyarrow as pa
import pytest
from error_tables import errors_table

from assemblyhands_core.metrics.annotation import Cell, Resampling
from assemblyhands_core.metrics.comparison import compare_methods, differences
from assemblyhands_core.metrics.error_rows import align_methods

RESAMPLING = Resampling(block_frames=3, num_resamples=400, seed=0)


def _compare(errors: pa.Table) -> dict[tuple[str, str], Cell]:
    return {(cell.row, cell.metric): cell for cell in compare_methods(errors, RESAMPLING)}


def test_a_later_round_is_held_against_each_before_it() -> None:
    hard = np.random.default_rng(0).gamma(2, 4, (60, 2))
    found = _compare(errors_table({"R2": 0.5 * hard, "2d_triangulation": hard, "R1": 0.8 * hard}))
    assert {row for row, _ in found} == {
        "R1 against 2d_triangulation", "R2 against 2d_triangulation", "R2 against R1"}  # fmt: skip
    ratio = found["R2 against R1", "mpjpe_mm_ratio"]
    assert [ratio.value, ratio.low, ratio.high] == pytest.approx([0.625] * 3, rel=1e-5)
    difference = found["R1 against 2d_triangulation", "mpjpe_mm_difference"]
    assert difference.value == pytest.approx(-0.2 * hard.mean(), rel=1e-5) and difference.high < 0
    assert found["R1 against 2d_triangulation", "pck_auc_difference"].low > 0


def test_giving_up_on_hard_joints_does_not_help_where_both_are_compared() -> None:
    truth = np.full((30, 2), 4.0)
    truth[::2] = 12.0
    picky = np.where(truth > 10, np.nan, truth)
    found = _compare(errors_table({"2d_triangulation": picky, "R1": truth * 0.9}))
    row = "R1 against 2d_triangulation"
    assert found[row, "mpjpe_mm_ratio"].value == pytest.approx(8 * 0.9 / 4, rel=1e-5)
    assert found[row, "mpjpe_mm_common_ratio"].value == pytest.approx(0.9, rel=1e-5)
    assert found[row, "mpjpe_mm_common_ratio"].n == found[row, "mpjpe_mm_ratio"].n / 2
    assert found[row, "mpjpe_mm_ratio"].coverage == 100.0


def test_rows_are_aligned_whatever_their_order_and_sequences_do_not_share_blocks() -> None:
    values = np.arange(14.0).reshape(7, 2)
    tables = [errors_table({"R1": values, "R2": values + 1}, sequence_id=name) for name in ("b", "a")]
    whole = pa.concat_tables(tables)
    shuffled = whole.take(np.random.default_rng(0).permutation(whole.num_rows))
    rows = align_methods(shuffled, block_frames=3)
    assert list(rows) == ["R1", "R2"] and np.all(rows["R2"].error_mm - rows["R1"].error_mm == 1)
    assert rows["R1"].num_blocks == 6
    assert rows["R1"].block.tolist() == [b for n in (0, 3) for b in (n,) * 6 + (n + 1,) * 6 + (n + 2,) * 2]


def test_methods_on_different_instants_are_refused() -> None:
    tables = [errors_table({"R1": np.ones((4, 2))}), errors_table({"R2": np.ones((5, 2))})]
    with pytest.raises(ValueError, match="method R2 has errors at 10 hands, R1 at 8"):
        compare_methods(pa.concat_tables(tables), RESAMPLING)


def test_every_figure_of_two_runs_differs_by_what_was_put_in() -> None:
    hard = np.random.default_rng(0).gamma(2, 2, (60, 2))
    rows = align_methods(errors_table({"R1": hard + 1.0, "R2": hard}, verbs=("screw", "remove")), 3)
    found = {(d.table, d.group, d.metric): d for d in differences(rows["R1"], rows["R2"], (0.4, 0.6), RESAMPLING)}
    for table, group in (("annotation", ""), ("annotation_by_finger", "index"), ("annotation_by_verb", "screw")):
        difference = found[table, group, "mpjpe_mm"]
        assert [difference.value, difference.low, difference.high] == pytest.approx([1.0] * 3, abs=1e-5)
        assert difference.first == pytest.approx(difference.second + 1, abs=1e-5)
    assert found["annotation", "", "pck_auc"].high < 0 and found["annotation", "", "coverage"].value == 0
    assert found["annotation_by_joint", "wrist", "mpjpe_mm"].n == 120
