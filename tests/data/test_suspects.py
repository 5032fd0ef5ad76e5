"""Hands are suspicious for the reasons that are stated, worst first, and not twice within a moment."""

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.catalog import JOINTS, RESIDUALS, ROUNDS
from assemblyhands_core.data.suspects import Suspect, SuspicionLimits, choose_suspects, find_suspects

LIMITS = SuspicionLimits(min_confidence=0.5, max_distance_px=10.0, max_displacement_mm=20.0, min_joints=21)
NUM_FRAMES = 4


def _joints(missing: int = 0, sources: tuple[str, ...] = ("mvexonet",) * NUM_FRAMES) -> pa.Table:
    """Good ones, but for some joints of frame 0."""
    rows = []
    for frame, source in enumerate(sources):
        valid = np.arange(21) >= (missing if frame == 0 else 0)
        row = {"sequence_id": "s", "frame": frame, "hand": "left", "round": 1, "source": source, "valid": valid}
        row |= {"joints_world_mm": np.zeros(63), "num_views": np.full(21, 4), "reprojection_px": np.full(21, 2.0)}
        rows.append(row | {"reason": np.where(valid, "", "no_detection").tolist()})
    return JOINTS.from_rows(rows)


def _rounds(**changes: dict[int, float | str]) -> pa.Table:
    """Good ones, but for a column's values at some frames."""
    good = {"round": 1, "box_source": "joints", "num_views": 4, "is_crop_outside": False, "confidence": 0.9}
    good |= {"displacement_mm": 1.0, "kept_round": 1, "reason": "", "note": ""}
    rows = []
    for frame in reversed(range(NUM_FRAMES)):  # in another order than the joints
        own = {name: values[frame] for name, values in changes.items() if frame in values}
        rows.append({"sequence_id": "s", "frame": frame, "hand": "left", **good, **own})
    return ROUNDS.from_rows(rows)


def test_good_hands_are_not_suspicious() -> None:
    converged = _rounds(reason={2: "converged"}, displacement_mm={1: np.nan})
    assert find_suspects(_joints(), [_rounds(), converged], RESIDUALS.empty(), LIMITS) == []


def test_each_reason_is_told_with_its_figure() -> None:
    last = _rounds(confidence={1: 0.25}, reason={2: "jumped"}, displacement_mm={3: 40.0})
    found = find_suspects(_joints(missing=7), [_rounds(displacement_mm={3: 60.0}), last], RESIDUALS.empty(), LIMITS)
    assert [(s.frame, s.reasons) for s in found] == [
        (0, ("7 missing: no_detection",)),
        (1, ("confidence 0.25",)),
        (2, ("last round not believed: jumped",)),
        (3, ("moved 60 mm in round 1", "moved 40 mm in round 2")),
    ]
    np.testing.assert_allclose([s.severity for s in found], [1 + 7 / 21, 2.0, 2.0, 3.0 + 2.0])


def test_without_rounds_views_that_do_not_agree_count_too() -> None:
    rows = [
        {"sequence_id": "s", "frame": 2, "hand": "left", "camera_id": name, "is_inlier": np.ones(21, dtype=bool)}
        | {"residual_px": np.where(np.arange(21) < 10, value, np.nan)}
        for name, value in (("a", 1.0), ("b", 45.0))
    ]
    (found,) = find_suspects(_joints(), [], RESIDUALS.from_rows(rows), LIMITS)
    assert (found.frame, found.reasons) == (2, ("off its 2D keypoints by 23.0 px",))


def test_what_people_have_corrected_is_not_asked_again() -> None:
    joints = _joints(missing=3, sources=("manual", *["mvexonet"] * 3))
    assert find_suspects(joints, [_rounds()], RESIDUALS.empty(), LIMITS) == []


def test_the_worst_come_first_and_their_neighbours_not_at_all() -> None:
    suspects = [Suspect(f, hand, s, ()) for f, hand, s in ((0, "left", 2.0), (2, "left", 9.0), (2, "right", 3.0))]
    suspects += [Suspect(frame, "left", 1.0, ()) for frame in (5, 6, 9)]
    chosen = choose_suspects(suspects, 4, 3)
    assert [(s.frame, s.hand) for s in chosen] == [(2, "left"), (2, "right"), (5, "left"), (9, "left")]
    assert [s.frame for s in choose_suspects(suspects, 1, 3)] == [2]
