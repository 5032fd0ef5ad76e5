import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from pipeline.rerun_view import ground_truth_folder

NAME = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"


def _truth(toy: Any, package: str, ground_truth: str = "", **recorded: Any) -> tuple[Path | None, str]:
    """Return the folder, and what is said, of a run that was made with a manifest of one sequence."""
    manifest = toy.folder / "set.csv"
    columns = "sequence_id,split,calibration,videos,package,ground_truth"
    manifest.write_text(f"{columns}\n{NAME},test,,,{package},{ground_truth}\n")
    run = toy.workspace / "runs" / "mine"
    run.mkdir(parents=True, exist_ok=True)
    (run / "run.json").write_text(json.dumps({"config": {"manifest": str(manifest), "rig": {}, **recorded}}))
    text = io.StringIO()
    config = toy.config().model_copy(update={"manifest": None, "workspace": toy.workspace})
    return ground_truth_folder(config, run, NAME, Console(file=text, width=200)), text.getvalue()


def test_the_studio_s_truth_is_where_the_studio_puts_it(toy: Any) -> None:
    assert _truth(toy, "synthetic") == (None, "")  # recorded elsewhere, or removed
    folder = toy.workspace / "synthetic" / "ground_truth" / NAME
    folder.mkdir(parents=True)
    assert _truth(toy, "synthetic") == (folder, "")


def test_other_truth_is_where_the_manifest_says(toy: Any) -> None:
    assert _truth(toy, "", "truth/here") == (toy.folder / "truth/here", "")
    assert _truth(toy, "") == (None, "") == _truth(toy, "pose2sim")


@pytest.mark.parametrize("rig", [{}, {"calibration": "a.json", "videos": "*.mp4"}])
def test_a_rig_of_one_s_own_has_none_and_a_manifest_that_is_gone_is_named(toy: Any, rig: dict[str, str]) -> None:
    folder, said = _truth(toy, "", "truth", rig=rig, manifest=str(toy.folder / "gone.csv"))
    assert folder is None and ("gone.csv" in said) == (not rig)
