"""``make all PRESET=tiny``: everything from recordings to the paper's tables, and then only what a change asks for."""

import csv
from pathlib import Path

import pytest
from command_line import TIMEOUT_S, Outcome, digests, entries, finish, new_stages, pipeline, start

_COMMAND = ("all", "preset=tiny")
_WHOLE_S = 10 * TIMEOUT_S


def _tables(workspace: Path) -> dict[str, list[dict[str, str]]]:
    """Return the rows of every table that the run's report is made of."""
    files = sorted((workspace / "runs" / "latest" / "report").glob("*.csv"))
    return {path.stem: list(csv.DictReader(path.open())) for path in files}


def _all(workspace: Path, *parameters: str) -> Outcome:
    return finish(start(*_COMMAND, *parameters, workspace=workspace), timeout_s=_WHOLE_S)


@pytest.mark.slow
def test_everything_from_recordings_to_the_tables(tmp_path: Path) -> None:
    workspace = tmp_path / "work"
    outcome = _all(workspace)
    assert outcome.code == 0, outcome.err + outcome.out[-3000:]
    run = workspace / "runs" / "latest"
    assert "<title>" in (run / "report" / "report.html").read_text()
    tables = _tables(workspace)
    assert {row["row"] for row in tables["metrics"]} >= {"2d_triangulation", "R1", "R2", "R3"}
    assert {row["network"] for row in tables["ego_cross"]} == {"Train-M+A"}
    assert {row["row"] for row in tables["verbs"]} >= {"annotation", "svegonet", "ego_only"}

    before, made = entries(workspace), digests(workspace)
    again = _all(workspace)
    assert again.code == 0 and digests(workspace) == made
    assert new_stages(workspace, before) == {}

    change = "smooth_joints.max_gap_frames=4"
    assert (
        "nothing to do" in pipeline("plan", "preset=tiny", "target=all", change, workspace=workspace).assert_done().said
    )
    change = "evaluate.num_resamples=150"
    planned = pipeline("plan", "preset=tiny", "target=all", change, workspace=workspace).assert_done().said
    assert "num_resamples" in planned and "1000 → 150" in planned
    assert _all(workspace, change).code == 0
    assert set(new_stages(workspace, before)) == {"evaluate"}
