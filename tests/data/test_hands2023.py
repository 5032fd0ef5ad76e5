"""The challenge's template, filled in place: its frames stay, hands that are not there are zeros."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.hands2023 import SUBMISSION_NAME, write_submission
from assemblyhands_core.data.json_files import FormatError


def _template(folder: Path) -> Path:
    blank = {"world_coord": [[-1.0] * 3] * 42, "joint_valid": [1] * 42}
    document = {"info": {"version": "v1-3"}, "annotations": {"rec": {"000124": blank, "000126": blank}}}
    path = folder / "template.json"
    path.write_text(json.dumps(document))
    return path


def test_the_template_is_filled_and_zipped(tmp_path: Path) -> None:
    joints = np.arange(126, dtype=np.float64).reshape(42, 3)
    joints[21:] = np.nan
    archive, problems = write_submission(_template(tmp_path), {"rec": {124: joints, 130: joints}}, tmp_path)
    assert problems == ["rec: 1 of 2 frames are not predicted, 000126 the first"]
    with zipfile.ZipFile(archive) as file:
        assert file.namelist() == [SUBMISSION_NAME]
        document = json.loads(file.read(SUBMISSION_NAME))
    frames = document["annotations"]["rec"]
    assert list(frames) == ["000124", "000126"] and document["info"] == {"version": "v1-3"}
    assert frames["000124"]["world_coord"][:21] == joints[:21].tolist()
    assert (
        frames["000124"]["world_coord"][21:] == [[0.0] * 3] * 21 and frames["000126"]["world_coord"] == [[0.0] * 3] * 42
    )
    assert frames["000124"]["joint_valid"] == [1] * 42


def test_another_file_is_no_template(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text('{"annotations": {"rec": 3}}')
    with pytest.raises(FormatError, match=r"other\.json: rec"):
        write_submission(tmp_path / "other.json", {}, tmp_path)
