"""Figures of verb classification, worked by hand."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.evaluation_tables import EVALUATION
from assemblyhands_core.metrics.annotation import Cell
from assemblyhands_core.metrics.run_differences import Difference
from assemblyhands_core.metrics.verb_rows import align_sources
from assemblyhands_core.metrics.verbs import VerbEvaluation, calibration_error_percent, evaluate_verbs, verb_differences

VERBS = ("pick up", "screw", "unscrew")
EVALUATION_OF = VerbEvaluation(VERBS, "annotations", "recording", num_resamples=200, seed=0, num_bins=5)

TRUE = ["pick up"] * 5 + ["screw"] * 3 + ["unscrew"] * 2
ANNOTATIONS = ["pick up"] * 4 + ["screw"] + ["screw"] * 2 + ["unscrew"] + ["unscrew"] * 2
PREDICTED = ["pick up"] * 3 + ["screw", ""] + ["screw", "unscrew", "unscrew"] + ["unscrew", "pick up"]


def _table(predicted: dict[str, list[str]], true: list[str] = TRUE, **columns: Any) -> pa.Table:
    """Return predictions of segments of ten recordings, one each unless told otherwise."""
    count = len(true)
    tables = []
    for number, (source, verbs) in enumerate(predicted.items()):
        standard = {
            "sequence_id": [f"r{i:02d}" for i in range(count)],
            "segment": list(range(count)),
            "first_frame": [60 * i for i in range(count)],
            "source": [source] * count,
            "verb": true,
            "predicted": verbs,
            "confidence": np.full(count, 0.5 + 0.1 * number, dtype=np.float32),
            "pose_error_mm": np.arange(count, dtype=np.float32) + 10 * number,
            "coverage": np.full(count, 100.0 - 10 * number, dtype=np.float32),
        }
        tables.append(pa.table(standard | columns))
    return pa.concat_tables(tables)


def _evaluate(table: pa.Table, evaluation: VerbEvaluation = EVALUATION_OF) -> dict[tuple[str, str, str, str], Cell]:
    cells = evaluate_verbs(table, evaluation)
    found = {(cell.table, cell.group, cell.row, cell.metric): cell for cell in cells}
    assert len(found) == len(cells)
    return found


BOTH = {"annotations": ANNOTATIONS, "svegonet": PREDICTED}


def test_accuracy_over_segments_and_over_verbs() -> None:
    found = _evaluate(_table(BOTH))
    assert found["verbs", "", "annotations", "accuracy"].value == 80.0
    assert found["verbs", "", "svegonet", "accuracy"].value == 50.0  # 3 + 1 + 1 of 10; without prediction is wrong
    mean_of_verbs = found["verbs", "", "svegonet", "mean_verb_accuracy"]
    assert mean_of_verbs.value == pytest.approx((60 + 100 / 3 + 50) / 3) and mean_of_verbs.n == 10
    assert found["verbs", "", "annotations", "mean_verb_accuracy"].value == pytest.approx((80 + 200 / 3 + 100) / 3)
    by_verb = {verb: found["verbs_by_verb", verb, "svegonet", "accuracy"] for verb in VERBS}
    assert {verb: cell.n for verb, cell in by_verb.items()} == {"pick up": 5, "screw": 3, "unscrew": 2}
    assert [by_verb[verb].value for verb in VERBS] == pytest.approx([60, 100 / 3, 50])


def test_relation_to_the_upper_bound() -> None:
    found = _evaluate(_table(BOTH))
    relative = found["verbs", "", "svegonet", "relative_accuracy"]
    assert relative.value == pytest.approx(62.5) and relative.low < 62.5 < relative.high and relative.n == 10
    expected = 100 * (60 + 100 / 3 + 50) / (80 + 200 / 3 + 100)
    of_verbs = found["verbs", "", "svegonet", "relative_mean_verb_accuracy"]
    assert of_verbs.value == pytest.approx(expected) and of_verbs.low < expected < of_verbs.high
    assert not any(row == "annotations" and metric.startswith("relative") for _, _, row, metric in found)
    difference = found["verbs_comparison", "", "svegonet against annotations", "accuracy_difference"]
    assert difference.value == pytest.approx(-30) and difference.low < -30 < difference.high
    alone = _evaluate(_table({"svegonet": PREDICTED}))
    assert not any("relative" in metric or table == "verbs_comparison" for table, _, _, metric in alone)


def test_pairs_serve_the_same_draws() -> None:
    """What is right and wrong in the same segments differs by nothing, however segments are drawn."""
    found = _evaluate(_table({"annotations": PREDICTED, "svegonet": PREDICTED}))
    for metric in ("accuracy_difference", "mean_verb_accuracy_difference"):
        cell = found["verbs_comparison", "", "svegonet against annotations", metric]
        assert (cell.value, cell.low, cell.high) == (0, 0, 0)
    relative = found["verbs", "", "svegonet", "relative_accuracy"]
    assert (relative.value, relative.low, relative.high) == pytest.approx((100, 100, 100))


def test_confusion_has_the_truth_in_rows() -> None:
    found = _evaluate(_table(BOTH))
    matrix = [[found["verbs_confusion", true, "svegonet", said].value for said in (*VERBS, "(none)")] for true in VERBS]
    np.testing.assert_allclose(matrix, [[60, 20, 0, 20], [0, 100 / 3, 200 / 3, 0], [50, 0, 50, 0]])
    assert found["verbs_confusion", "screw", "svegonet", "unscrew"].n == 3
    assert ("verbs_confusion", "screw", "annotations", "(none)") not in found


def test_distribution_of_truth_and_predictions() -> None:
    found = _evaluate(_table(BOTH))
    assert [found["verbs_distribution", verb, "truth", "share"].value for verb in VERBS] == [50, 30, 20]
    assert [found["verbs_distribution", verb, "svegonet", "share"].value for verb in VERBS] == [40, 20, 30]
    assert found["verbs_distribution", "screw", "truth", "share"].n == 10


def test_chance() -> None:
    found = _evaluate(_table(BOTH))
    frequent = "chance: most frequent verb"
    assert found["verbs", "", frequent, "accuracy"].value == 50.0
    assert found["verbs", "", frequent, "mean_verb_accuracy"].value == pytest.approx(100 / 3)
    assert found["verbs", "", "chance: uniform", "accuracy"].value == pytest.approx(100 / 3)
    assert found["verbs", "", "chance: uniform", "mean_verb_accuracy"].value == pytest.approx(100 / 3)


def test_pose_error_stands_beside_the_accuracy() -> None:
    error_mm = np.array([10, 20, np.nan, 30, 40] + [50] * 5, dtype=np.float32)
    found = _evaluate(_table({"svegonet": PREDICTED}, pose_error_mm=error_mm))
    overall = found["verbs", "", "svegonet", "pose_error_mm"]
    assert overall.value == pytest.approx(350 / 9) and overall.n == 9
    assert found["verbs_by_verb", "pick up", "svegonet", "pose_error_mm"].value == 25.0
    unknown = _evaluate(_table({"svegonet": PREDICTED}, pose_error_mm=np.full(10, np.nan)))
    assert np.isnan(unknown["verbs", "", "svegonet", "pose_error_mm"].value)
    assert unknown["verbs", "", "svegonet", "accuracy"].value == 50.0


def test_coverage_is_that_of_the_poses() -> None:
    coverage = np.array([100.0] * 5 + [40.0] * 3 + [70.0] * 2, dtype=np.float32)
    found = _evaluate(_table({"svegonet": PREDICTED}, coverage=coverage))
    assert found["verbs", "", "svegonet", "pose_coverage"].value == found["verbs", "", "svegonet", "accuracy"].coverage
    assert found["verbs", "", "svegonet", "accuracy"].coverage == pytest.approx(76.0)
    assert found["verbs_by_verb", "screw", "svegonet", "accuracy"].coverage == 40.0


def test_calibration_by_hand() -> None:
    confidence = np.array([0.9, 0.9, 0.9, 0.9, np.nan, 0.5, 0.5, 0.2, 0.2, 1.0], dtype=np.float64)
    found = _evaluate(_table({"svegonet": PREDICTED}, confidence=confidence))
    # Of nine predictions five are sure to 92 % and right in 3, two to 50 % and right in 1, two to 20 % and right in 1.
    top = {m: found["verbs_calibration", "0.80 to 1.00", "svegonet", m] for m in ("confidence", "accuracy", "share")}
    assert [cell.value for cell in top.values()] == pytest.approx([92.0, 60.0, 500 / 9])
    assert top["confidence"].n == top["accuracy"].n == 5 and top["share"].n == 9
    assert found["verbs_calibration", "0.40 to 0.60", "svegonet", "accuracy"].value == 50.0
    assert found["verbs_calibration", "0.20 to 0.40", "svegonet", "confidence"].value == pytest.approx(20.0)
    assert ("verbs_calibration", "0.60 to 0.80", "svegonet", "accuracy") not in found
    error = found["verbs", "", "svegonet", "calibration_error"]
    assert error.value == pytest.approx(100 * (5 * 0.32 + 2 * 0.0 + 2 * 0.3) / 9) and error.n == 9
    assert found["verbs", "", "svegonet", "confidence"].value == pytest.approx(600 / 9)


def test_a_classifier_that_knows_how_sure_it_is_has_no_calibration_error() -> None:
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0.2, 1.0, 20000)
    said = np.where(rng.random(20000) < confidence, "screw", "pick up").tolist()
    table = _table({"x": said}, ["screw"] * 20000, confidence=confidence)
    assert calibration_error_percent(align_sources(table, VERBS, "x", "recording")["x"], 10) < 1.5
    half = align_sources(_table({"x": said}, ["screw"] * 20000, confidence=confidence / 2), VERBS, "x", "recording")
    assert calibration_error_percent(half["x"], 10) == pytest.approx(30.0, abs=1.5)
    none = align_sources(_table({"x": [""] * 10}), VERBS, "x", "recording")
    assert np.isnan(calibration_error_percent(none["x"], 10))


def test_intervals_draw_persons_whole() -> None:
    """All recordings of a person are equally good: drawn by person intervals are wider, and with few there are none."""
    names = [
        f"nusar-2021_action_both_{1001 + i // 10}-a01_1001_user_id_2022-03-{i % 10 + 1:02d}_091830" for i in range(60)
    ]
    said = ["pick up" if i // 10 % 2 else "screw" for i in range(60)]
    table = _table({"annotations": said}, ["pick up"] * 60, sequence_id=names)
    widths = {}
    for blocks in ("recording", "person"):
        evaluation = VerbEvaluation(VERBS, "annotations", blocks, 500, 0)  # type: ignore[arg-type]
        for metric in ("accuracy", "mean_verb_accuracy"):
            cell = _evaluate(table, evaluation)["verbs", "", "annotations", metric]
            assert cell.value == 50.0 and cell.low < 50 < cell.high
            widths[blocks, metric] = cell.high - cell.low
    assert widths["person", "accuracy"] > 2 * widths["recording", "accuracy"]
    assert widths["person", "mean_verb_accuracy"] == pytest.approx(widths["person", "accuracy"])
    few = _evaluate(table.slice(0, 40), VerbEvaluation(VERBS, "annotations", "person", 200, 0))
    assert all(np.isnan(few["verbs", "", "annotations", m].low) for m in ("accuracy", "mean_verb_accuracy"))


def test_a_verb_that_does_not_occur_is_left_out_of_the_mean() -> None:
    found = _evaluate(_table({"annotations": ["pick up"] * 3 + ["screw"] * 3}, ["pick up"] * 4 + ["screw"] * 2))
    assert found["verbs", "", "annotations", "mean_verb_accuracy"].value == pytest.approx(87.5)
    assert np.isnan(found["verbs_by_verb", "unscrew", "annotations", "accuracy"].value)
    assert found["verbs_by_verb", "unscrew", "annotations", "accuracy"].n == 0
    assert found["verbs", "", "chance: most frequent verb", "mean_verb_accuracy"].value == 50.0


def test_every_line_fits_the_table_and_nothing_gives_nothing() -> None:
    cells = evaluate_verbs(_table(BOTH | {"ego only": PREDICTED[::-1]}), EVALUATION_OF)
    EVALUATION.from_rows([{"sequence_id": "", **cell._asdict()} for cell in cells])
    assert all(np.isnan(cell.low) or cell.low <= cell.value <= cell.high for cell in cells)
    pairs = {cell.row for cell in cells if cell.table == "verbs_comparison"}
    assert pairs == {"ego only against annotations", "svegonet against annotations", "svegonet against ego only"}
    assert evaluate_verbs(_table(BOTH).slice(0, 0), EVALUATION_OF) == []


def test_the_order_of_rows_is_of_no_matter() -> None:
    table = _table(BOTH)
    shuffled = table.take(np.random.default_rng(0).permutation(table.num_rows))
    first, second = (evaluate_verbs(one, EVALUATION_OF) for one in (table, shuffled))
    assert [tuple(map(str, cell)) for cell in first] == [tuple(map(str, cell)) for cell in second]


def _differences(first: list[str], second: list[str], **columns: Any) -> dict[tuple[str, str, str], Difference]:
    runs = [_table({"svegonet": said}, **columns).drop_columns("source") for said in (first, second)]
    return {(d.table, d.group, d.metric): d for d in verb_differences(*runs, EVALUATION_OF)}


def test_two_runs_differ_by_the_segments_that_one_tells_and_the_other_does_not() -> None:
    found = _differences(ANNOTATIONS, PREDICTED)
    accuracy = found["verbs", "", "accuracy"]
    assert (accuracy.first, accuracy.second, accuracy.value, accuracy.n) == (80.0, 50.0, 30.0, 10)
    assert 0 <= accuracy.low < 30 < accuracy.high <= 60, "paired: what both miss says nothing"
    of_verbs = found["verbs", "", "mean_verb_accuracy"]
    assert of_verbs.first == pytest.approx((80 + 200 / 3 + 100) / 3)
    assert of_verbs.value == pytest.approx((80 - 60 + 200 / 3 - 100 / 3 + 100 - 50) / 3)
    assert of_verbs.low < of_verbs.value < of_verbs.high
    by_verb = {verb: found["verbs_by_verb", verb, "accuracy"].value for verb in VERBS}
    assert by_verb == pytest.approx({"pick up": 20.0, "screw": 100 / 3, "unscrew": 50.0})
    assert found["verbs", "", "pose_error_mm"].value == found["verbs", "", "pose_coverage"].value == 0
    same = _differences(PREDICTED, PREDICTED)
    assert all(d.value == 0 and (np.isnan(d.low) or d.low == d.high == 0) for d in same.values())


def test_segments_of_one_recording_are_drawn_together_in_both_runs() -> None:
    few = _differences(ANNOTATIONS, PREDICTED, sequence_id=["a"] * 5 + ["b"] * 5)
    assert few["verbs", "", "accuracy"].value == 30.0
    assert all(np.isnan([d.low, d.high]).all() for d in few.values()), "two recordings say too little"


def test_runs_of_other_segments_are_refused() -> None:
    first = _table({"svegonet": PREDICTED}).drop_columns("source")
    with pytest.raises(ValueError, match="second has predictions of 9 segments, first of 10"):
        list(verb_differences(first, first.slice(1), EVALUATION_OF))
