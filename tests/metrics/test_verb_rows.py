"""Predictions of several sources are held against each other segment by segment."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.metrics.verb_rows import align_sources

VERBS = ("pick up", "screw", "unscrew")
FIRST = "nusar-2021_action_both_1001-a01_1001_user_id_2022-03-02_091830"
AGAIN = "nusar-2021_action_both_1001-b02_1001_user_id_2022-03-02_101830"
OTHER = "nusar-2021_action_both_1002-a01_1002_user_id_2022-03-03_091830"


def _table(source: str, predicted: list[str], **columns: Any) -> pa.Table:
    standard = {
        "sequence_id": [OTHER, FIRST, FIRST, AGAIN, "mine"],
        "segment": [0, 1, 0, 0, 0],
        "source": [source] * 5,
        "verb": ["screw", "unscrew", "pick up", "screw", "screw"],
        "predicted": predicted,
        "confidence": [0.5, 0.4, 0.3, 0.2, np.nan],
        "pose_error_mm": [1.0, 2.0, 3.0, 4.0, np.nan],
        "coverage": [100.0] * 5,
    }
    return pa.table(standard | columns)


SAID = ["screw", "screw", "pick up", "unscrew", ""]


def test_rows_are_sorted_by_recording_and_number() -> None:
    rows = align_sources(_table("a", SAID), VERBS, "a", "recording")["a"]  # "mine" and then 1001-a, 1001-b, 1002
    assert rows.true.tolist() == [1, 0, 2, 1, 1] and rows.predicted.tolist() == [-1, 0, 1, 2, 1]
    assert rows.is_right.tolist() == [False, True, False, False, True]
    assert rows.is_confident.tolist() == [False, True, True, True, True]
    assert rows.block.tolist() == [0, 1, 1, 2, 3] and rows.num_blocks == 4


def test_recordings_of_one_person_go_together() -> None:
    rows = align_sources(_table("a", SAID), VERBS, "a", "person")["a"]
    names = [["mine"], [FIRST, FIRST, AGAIN], [OTHER]]
    assert rows.num_blocks == len(names)
    assert len(set(rows.block[1:4].tolist())) == 1 and len(set(rows.block[[0, 1, 4]].tolist())) == 3


def test_sums_by_verb() -> None:
    rows = align_sources(_table("a", SAID), VERBS, "a", "recording")["a"]
    np.testing.assert_allclose(rows.accuracies().mean(), [100, 100 / 3, 0])
    sums = rows.sums(rows.pose_error_mm, np.isfinite(rows.pose_error_mm))
    assert sums.mean() == [2.5] and sums.count.ravel().tolist() == [0, 2, 1, 1]


def test_the_first_source_and_then_by_name() -> None:
    table = pa.concat_tables([_table(name, SAID) for name in ("b", "a", "upper")])
    assert list(align_sources(table, VERBS, "upper", "recording")) == ["upper", "a", "b"]


def test_sources_of_other_segments() -> None:
    table = pa.concat_tables([_table("a", SAID), _table("b", SAID).slice(0, 4)])
    with pytest.raises(ValueError, match=r"b has predictions of 4 segments, a of 5, .* classify the same segments"):
        align_sources(table, VERBS, "a", "recording")
    relabelled = pa.concat_tables([_table("a", SAID), _table("b", SAID, verb=["screw"] * 5)])
    with pytest.raises(ValueError, match="not the same"):
        align_sources(relabelled, VERBS, "a", "recording")


def test_verbs_that_are_none() -> None:
    with pytest.raises(ValueError, match="column predicted has 'shake', which is none of the classes pick up, screw"):
        align_sources(_table("a", ["shake", *SAID[1:]]), VERBS, "a", "recording")
    with pytest.raises(ValueError, match="column verb has ''"):
        align_sources(_table("a", SAID, verb=["", *SAID[1:4], "screw"]), VERBS, "a", "recording")
