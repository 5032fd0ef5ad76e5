"""Which estimates are believed, what stands for the others, and when a hand has converged."""

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from round_scene import (
    FRAMES,
    GUARD,
    KEYS,
    TRUE_MM,
    Answer,
    KnownAnswer,
    center_of,
    joints_table,
    points_of,
    truth_moved,
    truth_scaled,
)

from assemblyhands_core.data.catalog import KEYPOINTS
from assemblyhands_core.hands.joints import ROOT


@pytest.mark.parametrize(
    ("answer", "believed", "reason", "note"),
    [
        (truth_moved(0.0, 101.0, 0.0), truth_moved(0.0, 30.0, 0.0), "jumped", "its root jumped 101 mm"),
        (truth_scaled(1.6), truth_scaled(1.4), "implausible_bones", "1.60 of a mean hand's size"),
        (truth_scaled(0.5), truth_scaled(0.7), "implausible_bones", "0.50 of a mean hand's size"),
        (
            truth_moved(0.0, 90.0, 0.0),
            truth_moved(0.0, 60.0, 0.0),
            "high_reprojection",
            "px from the 2D keypoints, before 0.0",
        ),
    ],
)
def test_an_estimate_beyond_belief_gives_way_to_the_round_before(
    run: Any, answer: Answer, believed: Answer, reason: str, note: str
) -> None:
    tables = run(KnownAnswer(answer))
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        np.testing.assert_allclose(points_of(row), TRUE_MM[key], atol=1e-3)
        assert (row["round"], row["source"], set(row["reason"])) == (1, "kept_round_0", {""})
        assert (detail["kept_round"], detail["reason"]) == (0, reason) and note in detail["note"]
    tables = run(KnownAnswer(believed))
    assert {row["kept_round"] for row in tables["rounds"]} == {1}
    assert {row["source"] for row in tables["joints"]} == {"mvexonet"}


def test_joints_that_stand_on_a_view_of_four_are_nothing_to_hold_a_new_estimate_against(run: Any) -> None:
    answer, joints = truth_moved(0.0, 90.0, 0.0), joints_table()
    place = joints.schema.get_field_index("num_views")
    for num_views, reason in ((2, "high_reprojection"), (1, "")):
        column = pa.array([[num_views] * 21] * joints.num_rows, joints.schema.field(place).type)
        few = {"joints": joints.set_column(place, joints.schema.field(place), column)}
        assert {row["reason"] for row in run(KnownAnswer(answer), few)["rounds"]} == {reason}


def test_a_hand_whose_bones_vary_and_that_fits_its_keypoints_worse_keeps_the_round_before_all_along(run: Any) -> None:
    def answer(row: int, root: np.ndarray, is_left: bool) -> np.ndarray:
        varies = KEYS[row] == (FRAMES[1], "right")
        return truth_scaled(1.05 if varies else 1.0)(row, root, is_left) + 0.5

    tables = run(KnownAnswer(answer), guard=GUARD.model_copy(update={"min_instants": 2}))
    reasons = [(row["hand"], row["reason"], row["kept_round"]) for row in tables["rounds"]]
    assert sorted(set(reasons)) == [("left", "", 1), ("right", "unsteady", 0)] and len(reasons) == 4
    assert "0.0 mm in 2D + triangulation" in tables["rounds"][0]["note"]
    assert {row["reason"] for row in run(KnownAnswer(answer))["rounds"]} == {""}, "two instants say nothing by default"


def test_from_the_truth_an_estimate_counts_however_far_off_it_is(run: Any) -> None:
    true = joints_table(number=100)
    tables = run(
        KnownAnswer(truth_moved(0.0, 101.0, 0.0)), {"joints": true}, guard=GUARD.model_copy(update={"min_instants": 2})
    )
    assert {(row["round"], row["source"]) for row in tables["joints"]} == {(101, "mvexonet")}


def test_a_hand_does_not_become_the_other_one(run: Any) -> None:
    """Hands 60 mm apart: a jump by half of it and more ends nearer to the other one."""
    near = {key: TRUE_MM[key] - TRUE_MM[key][ROOT] + (60.0 * (key[1] == "left"), 0.0, -100.0) for key in KEYS}
    inputs = {"joints": joints_table(points=near), "keypoints": KEYPOINTS.empty()}
    guard = GUARD.model_copy(update={"max_body_distance_mm": 1e4})

    def answer(shift_mm: float) -> Answer:
        return lambda row, root, is_left: near[KEYS[row]] + ((-shift_mm if is_left else shift_mm), 0.0, 0.0)

    assert {row["reason"] for row in run(KnownAnswer(answer(31.0)), inputs, guard=guard)["rounds"]} == {"other_hand"}
    assert {row["reason"] for row in run(KnownAnswer(answer(29.0)), inputs, guard=guard)["rounds"]} == {""}


def test_a_hand_does_not_leave_its_body(run: Any) -> None:
    guard = GUARD.model_copy(update={"max_body_distance_mm": 60.0})
    tables = run(KnownAnswer(truth_moved(-29.0, 0.0, 0.0)), guard=guard)
    distances = [np.linalg.norm(TRUE_MM[key][ROOT] - (29.0, 0.0, 0.0) - center_of(key)) for key in KEYS]
    assert [row["reason"] for row in tables["rounds"]] == ["left_body" if d > 60 else "" for d in distances]
    assert {row["reason"] for row in run(KnownAnswer(truth_moved()), guard=guard)["rounds"]} == {""}


def test_without_a_round_before_to_keep_what_is_not_believed_is_missing(run: Any) -> None:
    tables = run(KnownAnswer(truth_scaled(2.0)), {"joints": joints_table(missing=tuple(range(21)))})
    for row, detail in zip(tables["joints"], tables["rounds"], strict=True):
        assert set(row["reason"]) == {"implausible_bones"} and np.isnan(points_of(row)).all()
        assert detail["kept_round"] == 1 and np.isnan(detail["displacement_mm"])


def test_a_hand_that_kept_its_joints_has_not_converged(run: Any) -> None:
    network = KnownAnswer(truth_moved())
    kept = {"joints": joints_table(2, source="kept_round_1"), "earlier_joints": joints_table(1)}
    assert {row["reason"] for row in run(network, kept, stop_below_mm=2.0)["rounds"]} == {""} and len(network.seen) == 4


def test_joints_that_are_kept_twice_still_tell_their_round(run: Any) -> None:
    kept = run(KnownAnswer(truth_scaled(2.0)), {"joints": joints_table(1, source="kept_round_0")})
    assert {row["source"] for row in kept["joints"]} == {"kept_round_0"}
    assert {(row["round"], row["kept_round"]) for row in kept["rounds"]} == {(2, 0)}


def test_a_hand_that_stands_still_is_not_estimated_anew_on_request(run: Any) -> None:
    shift_mm = np.zeros((21, 3))
    before = {key: TRUE_MM[key] + (shift_mm + (1.0 if key[0] == FRAMES[0] else 3.0, 0.0, 0.0)) for key in KEYS}
    inputs = {"earlier_joints": joints_table(1, points=before), "joints": joints_table(2, source="mvexonet")}
    network = KnownAnswer(lambda row, root, is_left: TRUE_MM[KEYS[2 + row]] + (0.5, 0.0, 0.0))
    tables = run(network, inputs, stop_below_mm=2.0)
    assert len(network.seen) == 2
    assert [row["reason"] for row in tables["rounds"]] == ["converged", "converged", "", ""]
    assert [row["kept_round"] for row in tables["rounds"]] == [2, 2, 3, 3]
    assert [row["displacement_mm"] for row in tables["rounds"]] == pytest.approx([0.0, 0.0, 0.5, 0.5], abs=1e-3)
    assert [row["source"] for row in tables["joints"]] == ["kept_round_2"] * 2 + ["mvexonet"] * 2
    for stop_below_mm, given in ((0.0, inputs), (2.0, {"joints": inputs["joints"], "earlier_joints": joints_table(2)})):
        network = KnownAnswer(truth_moved())
        run(network, given, stop_below_mm=stop_below_mm)
        assert len(network.seen) == 4
