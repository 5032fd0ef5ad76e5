"""2D keypoints that people set by hand: how they take part beside those of detectors, and which joints they hold.

A joint that people set in two views or more is theirs: it stands where these rays meet, and no later round moves it.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Shaped

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CORRECTIONS, JOINTS, KEYPOINTS
from assemblyhands_core.data.keypoint_rows import hand_codes, positions, rows_of_hands
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.hands.joints import JOINT_NAMES, NUM_JOINTS

NOT_SEEN: Final = 0
"""Visibility of a joint that a view does not show: what a detector saw there does not count."""
MIN_HOLDING_VIEWS: Final = 2
"""Views in which people have to set a joint for it to be theirs; with one, its depth is that of detectors."""
_OUTCOME: Final = ("joints_world_mm", "valid", "reason", "num_views", "reprojection_px")


def with_corrections(keypoints: pa.Table, corrections: pa.Table) -> pa.Table:
    """Return 2D keypoints in which those that people set take the place of what detectors found.

    Args:
        keypoints: `catalog.KEYPOINTS`.
        corrections: `catalog.CORRECTIONS`.

    Returns:
        `catalog.KEYPOINTS`; corrected rows have the source `manual`, corrected joints their weight as confidence, 0
        where they are not seen. Views of a hand that had no row get one.
    """
    if not corrections.num_rows:
        return keypoints
    places = {key: row for row, key in enumerate(_hand_views(keypoints))}
    rows: dict[tuple[int, str], dict[str, Any]] = {}
    for key, point in zip(_hand_views(corrections), corrections.to_pylist(), strict=True):
        if key not in rows:
            rows[key] = keypoints.slice(places[key], 1).to_pylist()[0] if key in places else _empty_row(point)
        _set(rows[key], point)
    order = np.arange(keypoints.num_rows + len(rows))  # of the old rows and then the new ones, which take their places
    is_new = np.array([key not in places for key in rows])
    changed = keypoints.num_rows + np.arange(len(rows))
    order[[places[key] for key in rows if key in places]] = changed[~is_new]
    wanted = np.concatenate([order[: keypoints.num_rows], changed[is_new]])
    return pa.concat_tables([keypoints, KEYPOINTS.from_rows(list(rows.values()))]).take(wanted)


def held_joints(hands: pa.Table, corrections: pa.Table) -> Bool[np.ndarray, "row joint=21"]:
    """Return which joints of each row's hand and instant people set in enough views to place them."""
    counts = joint_views(hands, corrections)
    return np.asarray(counts >= MIN_HOLDING_VIEWS)


def joint_views(hands: pa.Table, corrections: pa.Table) -> Shaped[np.ndarray, "row joint=21"]:
    """Return in how many views people set each joint of each row's hand and instant."""
    seen = corrections.filter(pc.field("visibility") > NOT_SEEN)
    counts: dict[int, np.ndarray] = {}
    joints = positions(seen["joint"], JOINT_NAMES)
    for code, joint in zip(hand_codes(seen).tolist(), joints.tolist(), strict=True):
        counts.setdefault(code, np.zeros(NUM_JOINTS, dtype=np.int64))[joint] += 1
    nothing = np.zeros(NUM_JOINTS, dtype=np.int64)
    found = [counts.get(code, nothing) for code in hand_codes(hands).tolist()]
    return np.stack(found) if found else np.empty((0, NUM_JOINTS), dtype=np.int64)


def is_corrected(hands: pa.Table, corrections: pa.Table) -> Bool[np.ndarray, " row"]:
    """Return of which rows' hands, at their instants, people corrected anything."""
    return np.isin(hand_codes(hands), hand_codes(corrections))


def with_held_joints(joints: pa.Table, triangulated: pa.Table, corrections: pa.Table) -> pa.Table:
    """Return a round's joints in which those that people hold are where triangulation has put them.

    Args:
        joints: `catalog.JOINTS` of the round.
        triangulated: Those of round 0, with the same hands.
        corrections: `catalog.CORRECTIONS`.

    Returns:
        `catalog.JOINTS`; rows with such a joint have the source `manual`.
    """
    triangulated = triangulated.take(rows_of_hands(joints, triangulated))
    is_held = held_joints(joints, corrections) & to_numpy(triangulated["valid"]).astype(bool)
    columns: dict[str, Any] = {name: joints[name] for name in JOINTS.schema.names}
    for name in _OUTCOME:
        own, first = (to_numpy(table[name]).reshape(len(is_held), NUM_JOINTS, -1) for table in (joints, triangulated))
        columns[name] = np.where(is_held[..., None], first, own).reshape(len(is_held), -1)
    columns["source"] = np.where(is_held.any(axis=1), MANUAL, to_numpy(joints["source"]))
    return JOINTS.build(columns)


def loose_notes(hands: pa.Table, corrections: pa.Table) -> list[str]:
    """Return for each row which joints people set in too few views to hold them, in a sentence; empty without any."""
    counts = joint_views(hands, corrections)
    names = [[JOINT_NAMES[j] for j in np.flatnonzero((row > 0) & (row < MIN_HOLDING_VIEWS))] for row in counts]
    return [f"corrected in one view, two hold a joint: {', '.join(found)}" if found else "" for found in names]


def _hand_views(table: pa.Table) -> list[tuple[int, str]]:
    """Return hand and instant, and view, of each row."""
    return list(zip(hand_codes(table).tolist(), table["camera_id"].to_pylist(), strict=True))


def _empty_row(point: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **{name: point[name] for name in KEYPOINTS.key},
        "keypoints_px": [float("nan")] * (2 * NUM_JOINTS),
        "confidence": [0.0] * NUM_JOINTS,
    }


def _set(row: dict[str, Any], point: Mapping[str, Any]) -> None:
    """Set one joint of a row of keypoints."""
    joint, is_seen = JOINT_NAMES.index(point["joint"]), point["visibility"] > NOT_SEEN
    row["keypoints_px"][2 * joint : 2 * joint + 2] = point["corrected_px"] if is_seen else [float("nan")] * 2
    row["confidence"][joint] = point["weight"] if is_seen else 0.0
    is_any = bool(np.any(np.asarray(row["confidence"]) > 0))
    row.update(source=MANUAL, valid=is_any, reason="" if is_any else "no_detection")


assert set(CORRECTIONS.key) == {*KEYPOINTS.key, "joint"}
