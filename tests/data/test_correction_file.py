"""The file of corrections is read as it was written; whatever is wrong in it is named with its line and reason."""

import math
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.correction_file import (
    COLUMNS,
    Correction,
    check_corrections,
    read_corrections,
    write_corrections,
)
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import lens_from_coefficients

SET = Correction("monday", 7, "front", "right", "index_tip", 12.25, -0.5, 2)
UNSEEN = Correction("monday", 2, "front", "left", "wrist", math.nan, math.nan, 0)


def _line(**changes: str) -> str:
    values = dict(zip(COLUMNS, ("monday", "7", "front", "right", "index_tip", "12.25", "3.5", "2"), strict=True))
    return ",".join((values | changes).values())


def _read(folder: Path, *lines: str) -> list[Correction]:
    path = folder / "monday.csv"
    path.write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    return read_corrections(path)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    write_corrections(tmp_path / "a" / "monday.csv", [SET, UNSEEN])
    unseen, found = read_corrections(tmp_path / "a" / "monday.csv")
    assert found == SET and unseen.key == UNSEEN.key and math.isnan(unseen.y_px)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["monday.csv"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (_line(frame="-1"), "line 2: unknown_frame: '-1'"),
        (_line(frame="1.5"), "unknown_frame"),
        (_line(frame="9" * 5000), "line 2: unknown_frame: '9"),
        (_line(hand="a" * 140_000), r"monday.csv: cannot be read as CSV \(field larger than field limit"),
        (_line(hand="Right"), "unknown_hand: 'Right'"),
        (_line(joint="elbow"), "unknown_joint: 'elbow'"),
        (_line(visibility="3"), "unknown_visibility: '3'"),
        (_line(x_px="nan"), "x_px: not_a_number: 'nan'"),
        (_line(y_px=""), "y_px: not_a_number: ''"),
        (_line(y_px="inf"), "not_a_number"),
        (_line() + ",9", "wrong_count"),
        (_line().rpartition(",")[0], "wrong_count"),
        (_line() + "\n" + _line(), "line 3: repeated_joint: right index_tip in front at frame 7"),
        (_line(joint="elbow") + "\n" + _line(hand="foot"), "2 entries in all are wrong"),
    ],
)
def test_what_is_malformed_is_refused(tmp_path: Path, line: str, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        _read(tmp_path, line)


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "monday.csv").write_text("frame,x\n1,2\n")
    with pytest.raises(FormatError, match="wrong_columns"):
        read_corrections(tmp_path / "monday.csv")
    (tmp_path / "monday.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="cannot be read"):
        read_corrections(tmp_path / "monday.csv")


@pytest.mark.parametrize(
    ("correction", "reason"),
    [
        (Correction("friday", 7, "front", "right", "wrist", 1.0, 1.0, 2), "wrong_sequence: it is of friday"),
        (Correction("monday", 10, "front", "right", "wrist", 1.0, 1.0, 2), "unknown_frame: .* 0 to 9"),
        (Correction("monday", 7, "back", "right", "wrist", 1.0, 1.0, 2), "unknown_view: .* front"),
        (Correction("monday", 7, "front", "right", "wrist", 119.6, 1.0, 2), "outside_picture"),
        (Correction("monday", 7, "front", "right", "wrist", 1.0, -0.6, 1), "outside_picture"),
    ],
)
def test_corrections_of_something_else_are_refused(correction: Correction, reason: str) -> None:
    lens = lens_from_coefficients("OpenCV", {})
    views = {"front": Camera("front", 120, 100, 90.0, 90.0, 59.5, 49.5, lens, np.eye(4))}
    check_corrections("monday.csv", [SET, UNSEEN], "monday", views, 10)
    with pytest.raises(FormatError, match=reason):
        check_corrections("monday.csv", [SET, correction], "monday", views, 10)
