"""Names in what an annotation tool gives back lead to the tasks of this workspace and to nothing else."""

from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.json_files import FormatError
from pipeline.config import UserError
from pipeline.correction_folders import read_task, task_folder, task_pictures, write_task


@pytest.fixture
def task(tmp_path: Path) -> Path:
    pictures = task_pictures("monday", [("front", 7, (64, 48), {"right": np.full((21, 2), 5.0)})])
    folder = task_folder(tmp_path / "corrections", pictures[0].file_name)
    (folder / "annotations").mkdir(parents=True)
    write_task(folder, pictures, [])
    return folder


def test_a_task_is_found_by_its_pictures_and_read_again(task: Path) -> None:
    ((name, picture),) = read_task(task).items()
    assert (picture.sequence_id, picture.camera_id, picture.frame) == ("monday", "front", 7)
    for before in ("", "images/", "/data/task_3/", "../"):
        assert task_folder(task.parents[1], before + name) == task


@pytest.mark.parametrize(
    "name",
    ["..--front--000007--0a1b2c3d.jpg", "monday--front--000007--...jpg", "--front--000007--0a1b2c3d.jpg",
     "monday--front--000007--.jpg", ".git--front--000007--0a1b2c3d.jpg", "monday.jpg", "", "..", "a\x00--b--c--d.jpg"],
)  # fmt: skip
def test_names_that_would_lead_elsewhere_are_no_pictures_of_a_task(tmp_path: Path, name: str) -> None:
    with pytest.raises(UserError, match="unknown_picture"):
        task_folder(tmp_path, name)


@pytest.mark.parametrize(
    ("old", "new"),
    [("monday,front", "../monday,front"), ("monday,front", "tuesday,front"), (",7", ",x"), (",7", ""),
     (",7", f",{'9' * 5000}"), ("frame\n", "f\n"), ("monday--", "sunday--")],
)  # fmt: skip
def test_a_task_whose_list_was_changed_is_refused(task: Path, old: str, new: str) -> None:
    path = task / "pictures.csv"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FormatError, match=r"pictures\.csv: line 2"):
        read_task(task)
