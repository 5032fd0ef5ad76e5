"""Which run the reading commands open, and what they say where there is none."""

from collections.abc import Callable
from pathlib import Path

import pytest
from html_runs import run_config, write_run
from rich.console import Console

from pipeline.comparison import compare_runs
from pipeline.config import RunConfig, UserError
from pipeline.finished import open_run
from pipeline.report import report_again
from pipeline.rerun_view import write_rerun_views
from pipeline.suspects import write_suspects


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a workspace with two runs, the newer of which is the latest."""
    workspace = tmp_path_factory.mktemp("work")
    for name in ("monday", "tuesday"):
        write_run(workspace, name, sequences=("a",))
    (workspace / "runs" / "latest").symlink_to("tuesday")
    return workspace


@pytest.mark.parametrize(("name", "opened"), [("", "tuesday"), ("latest", "tuesday"), ("monday", "monday")])
def test_a_run_is_opened_by_its_name_or_the_latest(workspace: Path, name: str, opened: str) -> None:
    assert open_run(run_config(workspace), name).name == opened


@pytest.mark.parametrize("command", [report_again, compare_runs, write_rerun_views, write_suspects])
def test_all_commands_say_the_same_of_a_run_that_is_not_there(
    workspace: Path, tmp_path: Path, command: Callable[[RunConfig, Console], int]
) -> None:
    update = {"other": "monday", "corrections": tmp_path}
    asked = run_config(workspace).model_copy(update={**update, "run": "sunday"})
    with pytest.raises(UserError) as refused:
        command(asked, Console(quiet=True))
    assert str(refused.value) == f"there is no run sunday in {workspace}/runs; choose among tuesday, monday"
    with pytest.raises(UserError) as refused:
        command(run_config(tmp_path).model_copy(update=update), Console(quiet=True))
    assert str(refused.value) == f"there is no run in {tmp_path}/runs yet; `make annotate` makes one"
