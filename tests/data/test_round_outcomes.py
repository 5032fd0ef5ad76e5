"""Means that leave out what is unknown, and which joints a round gives."""

import dataclasses

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.round_outcomes import RoundOutcome, displacement_mm, mean_of_known
from assemblyhands_core.data.rounds import HandWindows


def _previous(is_valid: list[bool]) -> pa.Table:
    rows = []
    for frame, valid in enumerate(is_valid):
        row = {"sequence_id": "s", "frame": frame, "hand": "left", "source": "mvexonet", "round": 1}
        row |= {"joints_world_mm": np.full(63, 1.0 if valid else np.nan), "valid": np.full(21, valid)}
        row |= {"reason": [""] * 21, "num_views": np.full(21, 7), "reprojection_px": np.full(21, 2.5)}
        rows.append(row)
    return JOINTS.from_rows(rows)


def _outcome(reasons: list[str], is_valid: list[bool]) -> RoundOutcome:
    count = len(reasons)
    windows = [HandWindows(np.zeros(3), True, (), (), False, "joints")] * count
    joints = np.tile([4.0, 5.0, 1.0], (count, 21, 1))
    confidence = np.tile(np.where(np.arange(21) < 5, 0.1, 0.9), (count, 1))
    texts = np.array(reasons, dtype=object)
    return RoundOutcome(_previous(is_valid), windows, joints, confidence, np.full((count, 21), 8.0), texts, texts, 0.5)


def test_a_hand_gets_new_joints_old_ones_or_none() -> None:
    outcome = _outcome(["", "jumped", "jumped", "too_few_views"], [True, True, False, True])
    assert outcome.is_kept.tolist() == [False, True, False, True]
    new, kept, lost, unseen = outcome.joints().to_pylist()
    assert new["reason"] == ["low_confidence"] * 5 + [""] * 16 and new["source"] == "mvexonet"
    assert np.isnan(new["joints_world_mm"][:15]).all() and new["joints_world_mm"][15:18] == [4.0, 5.0, 1.0]
    assert np.isnan(new["reprojection_px"][4]) and new["reprojection_px"][5] == 8.0
    for row in (kept, unseen):
        assert (set(row["joints_world_mm"]), set(row["num_views"]), row["source"]) == ({1.0}, {7}, "kept_round_1")
        assert set(row["reprojection_px"]) == {2.5} and all(row["valid"])
    assert set(lost["reason"]) == {"jumped"} and not any(lost["valid"])
    rounds = outcome.rounds().to_pylist()
    assert [row["kept_round"] for row in rounds] == [2, 1, 2, 1] and {row["round"] for row in rounds} == {2}
    assert [row["reason"] for row in rounds] == ["", "jumped", "jumped", "too_few_views"]
    assert rounds[0]["displacement_mm"] == rounds[1]["displacement_mm"] == 5.0
    assert np.isnan(rounds[2]["displacement_mm"])


def test_a_hand_of_which_no_joint_is_sure_keeps_what_it_had() -> None:
    outcome = _outcome(["", ""], [True, False])
    unsure = dataclasses.replace(outcome, confidence=np.full((2, 21), 0.4))
    kept, lost = unsure.joints().to_pylist()
    assert (kept["source"], set(kept["joints_world_mm"])) == ("kept_round_1", {1.0})
    assert set(lost["reason"]) == {"low_confidence"} and not any(lost["valid"])
    assert {row["reason"] for row in unsure.rounds().to_pylist()} == {"low_confidence"}
    just = np.where(np.arange(21) == 20, 0.5, 0.4)
    assert not dataclasses.replace(outcome, confidence=np.tile(just, (2, 1))).is_kept.any()


def test_means_are_over_what_is_known() -> None:
    values = np.array([[1.0, np.nan, 3.0], [np.nan] * 3])
    np.testing.assert_array_equal(mean_of_known(values, axis=1), [2.0, np.nan])
    one, other = np.zeros((1, 21, 3)), np.zeros((1, 21, 3))
    one[0, 0], other[0, 1], other[0, 2:] = np.nan, np.nan, (0.0, 3.0, 4.0)
    assert displacement_mm(one, other)[0] == pytest.approx(5.0)
