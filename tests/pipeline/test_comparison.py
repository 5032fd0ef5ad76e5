"""Two made-up runs beside one another."""

import io
from pathlib import Path

import pytest
from html_runs import HOSTILE, run_config, write_run
from rich.console import Console

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


@pytest.mark.parametrize(
    ("run", "other", "sentence"),
    [
        ("good", "", "compare takes two runs"),
        ("good", "no", "there is no run no"),
        ("good", "far", "no sequence in common"),
    ],
)
def test_what_cannot_be_compared_is_refused(runs: Path, run: str, other: str, sentence: str) -> None:
    config = run_config(runs).model_copy(update={"run": run, "other": other})
    with pytest.raises(UserError, match=sentence):
        compare_runs(config, Console(quiet=True))
