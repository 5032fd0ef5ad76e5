from pathlib import Path

import numpy as np
import pytest
from finished_run import write_rounds

from assemblyhands_core.data.rounds import WindowRule
from pipeline.round_crops import read_courses

RULE = WindowRule(gamma=1.5, min_joints=11, min_inside=0.5)


def test_the_hands_that_moved_most_are_read_with_all_rounds(tmp_path: Path) -> None:
    """In chunk 0 the second instant moves farthest, in chunk 1 the first."""
    write_rounds(tmp_path, "s", 0, [(0, 1, 2), (40, 20, 10), (0, 0, 0)])
    write_rounds(tmp_path, "s", 1, [(0, -20, -25), (0, 9, 9), (0, 1, 2)])
    first, second = read_courses(tmp_path, RULE, max_hands=2)
    assert (first.key, second.key) == (("s", 1, "right"), ("s", 10, "right"))
    assert [look.caption for look in first.looks] == ["2D + triangulation", "R1: moved 20.0 mm", "R2: moved 10.0 mm"]
    # 1 px a mm in the rectified view, half of that in the crop, which is 120 px wide around the same middle.
    detected, joints = (look.box for look in first.looks[1:])
    assert detected is not None and joints is not None
    np.testing.assert_allclose(detected.center_px, (59.5, 59.5), atol=1e-6)
    np.testing.assert_allclose(joints.center_px, (59.5 + 10, 59.5), atol=1e-4)
    assert (detected.side_px, joints.side_px) == (pytest.approx(60.0), pytest.approx(1.5 * 20, abs=1e-4))
    np.testing.assert_allclose(second.looks[2].joints_px[0], (59.5 - 12.5 - 10, 59.5 - 10), atol=1e-4)


def test_hands_are_of_all_sequences(tmp_path: Path) -> None:
    for name, far in (("monday", 5), ("tuesday", 50)):
        write_rounds(tmp_path, name, 0, [(0, far)] * 3)
    assert [course.key[0] for course in read_courses(tmp_path, RULE)] == ["monday"] * 2 + ["tuesday"] * 2
    assert [course.key[0] for course in read_courses(tmp_path, RULE, max_hands=1)] == ["tuesday"]


def test_what_failed_in_a_round_is_left_out(tmp_path: Path) -> None:
    for chunk in (0, 1):
        write_rounds(tmp_path, "s", chunk, [(0, 5)])
    (tmp_path / "round_1" / "joints" / "s.00000.parquet").unlink()
    assert [course.key for course in read_courses(tmp_path, RULE)] == [("s", 10, "right")]


@pytest.mark.parametrize("lacking", ["round_1", "crop_hands", "detect_hands"])
def test_without_two_rounds_or_crops_there_is_nothing(tmp_path: Path, lacking: str) -> None:
    write_rounds(tmp_path, "s", 0, [(0, 5)])
    assert len(read_courses(tmp_path, RULE)) == 1
    (tmp_path / lacking).rename(tmp_path / "elsewhere")
    assert read_courses(tmp_path, RULE) == []
    assert read_courses(tmp_path / "nowhere", RULE) == []
