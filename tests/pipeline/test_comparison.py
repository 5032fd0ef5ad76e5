"""Two made-up runs beside one another."""

import io
import json
from pathlib import Path

import pytest
from error_tables import ego_errors_table
from finished_run import write_table
from html_runs import HOSTILE, run_config, write_run
from rich.console import Console

from assemblyhands_core.data.evaluation_tables import EGO_ERRORS
from assemblyhands_core.data.fine_grained import VERBS
from assemblyhands_core.data.verb_tables import VERB_PREDICTIONS
from pipeline.comparison import compare_runs
from pipeline.config import UserError


def _compared(workspace: Path, run: str, other: str) -> tuple[list[list[str]], str, str]:
    """Return the printed rows, all that was said, and the page."""
    said = io.StringIO()
    config = run_config(workspace).model_copy(update={"run": run, "other": other})
    assert compare_runs(config, Console(file=said, width=200)) == 0
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in said.getvalue().splitlines() if "│" in line]
    page = workspace / "runs" / run / "report" / f"compare_{run}_{other}.html"
    assert f"report: {page}" in said.getvalue()
    return rows, said.getvalue(), page.read_text()


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    workspace = tmp_path_factory.mktemp("work")
    write_run(workspace, "good")
    write_run(workspace, "bad", worse_by=1.5, sequences=(HOSTILE, "tuesday", "another"))
    write_run(workspace, "far", sequences=("elsewhere",))
    return workspace


def test_figures_stand_beside_one_another_with_paired_intervals_and_a_verdict(runs: Path) -> None:
    rows, _, page = _compared(runs, "good", "bad")
    found = {(row[0], row[1]): row[2:] for row in rows}
    good, bad, difference, verdict, n = found["R1", "MPJPE (mm)"]
    assert float(bad) == pytest.approx(1.5 * float(good), abs=0.002) and float(good) == pytest.approx(4, abs=0.2)
    assert float(difference.split()[0]) == pytest.approx(float(good) - float(bad), abs=0.002)
    assert (verdict, n) == ("good is better", str(2 * 20 * 2 * 21))
    assert found["R1", "PCK-AUC (%)"][3] == "good is better"
    assert found["2D + triangulation", "MPJPE (mm)"][2:4] == ["0", "equal"]
    assert "on 2 sequences that both have" in page and "of_another_version" in page and "By finger" in page
    assert page.count("<script>") == 1 and "different sequences" in page


def test_which_run_is_better_does_not_depend_on_the_order(runs: Path) -> None:
    rows, _, _ = _compared(runs, "bad", "good")
    assert {(row[0], row[1]): row[5] for row in rows}["R2", "MPJPE (mm)"] == "good is better"


def _write_networks(run: Path, worse_mm: float, told: str) -> None:
    """Write an egocentric network's errors, and what a classifier says of twelve recordings with one segment each."""
    errors = ego_errors_table(12)
    error_mm = [[mm + worse_mm for mm in row] for row in errors["error_mm"].to_pylist()]
    rows = [{**row, "error_mm": mm} for row, mm in zip(errors.to_pylist(), error_mm, strict=True)]
    write_table(run / "errors_manual_both" / "errors" / "s.parquet", EGO_ERRORS, EGO_ERRORS.from_rows(rows))
    segments = [
        {
            "sequence_id": f"r{number}",
            "segment": 0,
            "verb": "screw",
            "predicted": "screw" if number % 2 else told,
            "confidence": 0.5,
            "probability": [0.0] * len(VERBS),
            "first_key": 0,
            "pose_error_mm": 7.0,
            "coverage": 100.0,
        }
        for number in range(12)
    ]
    predictions = VERB_PREDICTIONS.from_rows(segments)
    write_table(run / "verbs_svegonet" / "predictions" / "r.parquet", VERB_PREDICTIONS, predictions)
    shards = {name: {} for name in ("s", *(f"r{number}" for number in range(12)))}
    (run / "verbs_svegonet" / "manifest.json").write_text(json.dumps({"stage": "s", "shards": shards}))


def test_networks_are_held_against_each_other_on_the_same_crops_and_segments(tmp_path: Path) -> None:
    for name, worse_mm, told in (("near", 0.0, "screw"), ("off", 2.0, "pick up")):
        _write_networks(write_run(tmp_path, name), worse_mm, told)
    rows, _, page = _compared(tmp_path, "near", "off")
    found = {(row[0], row[1]): row[2:] for row in rows}
    near, off, difference, verdict, n = found["Train-M+A, Eval-M", "wrist-relative MPJPE (mm)"]
    assert (near, off) == (f"{6 * 20 / 21:.3f}", f"{6 * 20 / 21 + 2:.3f}")  # 1 to 11 mm; the wrist has no error
    assert (difference, verdict, n) == ("-2.000 (-2.000 to -2.000)", "near is better", str(11 * 21))
    assert found["svegonet", "accuracy (%)"][:2] == ["100.000", "50.000"]
    assert (
        found["svegonet", "accuracy (%)"][3]
        == found["svegonet", "accuracy, mean over verbs (%)"][3]
        == "near is better"
    )
    assert "By camera; egocentric hands" in page and "By verb; verbs, shipped network, our annotation" in page


@pytest.mark.parametrize(
    ("run", "other", "sentence"),
    [
        ("good", "", "compare takes two runs"),
        ("good", "no", "there is no run no in .*/runs; choose among far, bad, good$"),
        ("good", "far", "no sequence in common"),
    ],
)
def test_what_cannot_be_compared_is_refused(runs: Path, run: str, other: str, sentence: str) -> None:
    config = run_config(runs).model_copy(update={"run": run, "other": other})
    with pytest.raises(UserError, match=sentence):
        compare_runs(config, Console(quiet=True))
