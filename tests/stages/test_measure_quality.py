"""Quality tables of annotations whose every figure can be worked out by hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.catalog import BODIES, BODY_KEYPOINTS, JOINTS, RESIDUALS
from assemblyhands_core.hands.body import ARMS
from assemblyhands_core.hands.joints import WRIST
from stages._contract import Context
from stages.measure_quality import STAGE, MeasureQualityConfig

CONFIG = MeasureQualityConfig(num_sync_frames=1000, max_shift_frames=4, max_reprojection_px=10.0)
# A right hand laid flat: finger f runs along x at y = 20 f, joints 30 mm apart from the base to the tip; wrist at 0.
FLAT_MM = np.array([*[(100.0 + 30 * (3 - end), 20.0 * f, 0.0) for f in range(5) for end in range(4)], (0.0, 0.0, 0.0)])


def _outcome(valid: np.ndarray, reason: np.ndarray) -> dict[str, Any]:
    return {
        "valid": valid,
        "reason": np.where(valid, "", reason),
        "num_views": np.where(valid, 3, 0),
        "reprojection_px": np.where(valid, 2.0, np.nan),
    }


def _joints(points_mm: np.ndarray, reason: np.ndarray | None = None, number: int = 0, source: str = "test") -> pa.Table:
    """The table of (F, H, 21, 3) joints of a round, valid where finite."""
    valid = np.isfinite(points_mm).all(axis=-1).reshape(-1, 21)
    reason = np.full(valid.shape, "too_few_views", dtype=object) if reason is None else reason.reshape(-1, 21)
    num_frames = len(points_mm)
    return JOINTS.build(
        {
            "sequence_id": ["s"] * len(valid),
            "frame": np.repeat(np.arange(num_frames), 2),
            "hand": ["right", "left"] * num_frames,
            "joints_world_mm": points_mm.reshape(-1, 63),
            **_outcome(valid, reason),
            "source": [source] * len(valid),
            "round": [number] * len(valid),
        }
    )


def _residuals(residual_px: np.ndarray, is_inlier: np.ndarray) -> pa.Table:
    """The table of (F, H, V, 21) residuals."""
    num_frames, _, num_views, _ = residual_px.shape
    return RESIDUALS.build(
        {
            "sequence_id": ["s"] * (num_frames * 2 * num_views),
            "frame": np.repeat(np.arange(num_frames), 2 * num_views),
            "hand": list(np.repeat(["right", "left"], num_views)) * num_frames,
            "camera_id": list("abcd"[:num_views]) * (2 * num_frames),
            "residual_px": residual_px.reshape(-1, 21),
            "is_inlier": is_inlier.reshape(-1, 21),
        }
    )


def _bodies(body_mm: np.ndarray, skipped: Sequence[int] = ()) -> pa.Table:
    valid = np.isfinite(body_mm).all(axis=-1)
    reason = np.full(valid.shape, "too_few_views", dtype=object)
    reason[list(skipped)] = "skipped_frame"
    return BODIES.build(
        {
            "sequence_id": ["s"] * len(body_mm),
            "frame": np.arange(len(body_mm)),
            "body_world_mm": body_mm.reshape(-1, 51),
            **_outcome(valid, reason),
        }
    )


def _seen(world: Any, late: Mapping[str, int] | None = None, off_px: Mapping[str, Any] | None = None) -> pa.Table:
    """The table of body keypoints of a world, some views late or looking elsewhere."""
    tables = []
    for camera in world.cameras:
        frame = np.arange(len(world.body_mm))
        pixels = camera.project(world.body_mm) + (off_px or {}).get(camera.camera_id, 0.0)
        pixels = pixels[np.maximum(frame - (late or {}).get(camera.camera_id, 0), 0)]
        columns = {"sequence_id": ["s"] * len(frame), "frame": frame, "camera_id": [camera.camera_id] * len(frame)}
        columns |= {"body_px": pixels.reshape(-1, 34), "confidence": np.ones((len(frame), 17))}
        columns |= {"num_persons": np.ones(len(frame)), "valid": [True] * len(frame), "reason": [""] * len(frame)}
        tables.append(BODY_KEYPOINTS.build(columns))
    return pa.concat_tables(tables)


def _run(world: Any, config: MeasureQualityConfig = CONFIG, **tables: Any) -> dict[tuple[str, str, str], Any]:
    """Return (value, n) by table, row and metric; tables that are not given hold one flat hand in all frames."""
    flat = np.broadcast_to(FLAT_MM, (2, 2, 21, 3))
    inputs = {
        "views": world.views(),
        "body_keypoints": _seen(world),
        "bodies": _bodies(world.body_mm),
        "joints": _joints(flat),
        "triangulated": _joints(flat),
        "residuals": _residuals(np.full((2, 2, 4, 21), 1.0), np.full((2, 2, 4, 21), True)),
    }
    rows = STAGE.run(config, inputs | tables, Context(Path(), "s"))["quality"].to_pylist()
    return {(row["table"], row["row"], row["metric"]): (row["value"], row["n"]) for row in rows}


def test_agreement_tells_how_far_the_last_round_is_from_triangulation_and_whose_bones_are_constant(world: Any) -> None:
    first = np.broadcast_to(FLAT_MM, (4, 2, 21, 3)).copy()
    first[0, 0, 0, 0] += 30.0
    last = np.broadcast_to(FLAT_MM, (4, 2, 21, 3)) + np.array([0.0, 3.0, 4.0])
    last[1, 0, 5] = np.nan
    cells = _run(world, joints=_joints(last, number=2, source="kept_round_1"), triangulated=_joints(first))
    agreement = {key[1:]: cell for key, cell in cells.items() if key[0] == "agreement with 2D + triangulation"}
    assert agreement["right", "median distance (mm)"] == (pytest.approx(5.0, abs=1e-5), 4 * 21 - 1)
    assert agreement["right", "within 20 mm (%)"] == (pytest.approx(100 * 82 / 83), 83)
    assert agreement["right", "hands kept from an earlier round (%)"] == (100.0, 4)
    assert agreement["right", "bones' spread (mm)"][0] == pytest.approx(0.0, abs=1e-4)
    assert agreement["left", "bones' spread before (mm)"] == (pytest.approx(0.0, abs=1e-4), 80)
    assert not any(key[0].startswith("agreement with") for key in _run(world)), "round 0 agrees with itself"


def test_coverage_counts_every_joint_once_by_outcome(world: Any) -> None:
    points = np.broadcast_to(FLAT_MM, (5, 2, 21, 3)).copy()
    points[0, 0] = np.nan
    points[1:3, 0, :7] = np.nan
    reason = np.full((5, 2, 21), "no_detection", dtype=object)
    reason[1:3, 0] = "outside_hand"
    cells = _run(world, joints=_joints(points, reason))
    outcomes = {key[1:]: cell for key, cell in cells.items() if key[0] == "joints by outcome (%)"}
    assert outcomes == {
        ("valid", "right"): (pytest.approx(100 * 70 / 105), 70),
        ("no_detection", "right"): (pytest.approx(20.0), 21),
        ("outside_hand", "right"): (pytest.approx(100 * 14 / 105), 14),
        ("valid", "left"): (100.0, 105),
    }


def test_reprojection_is_the_median_of_inliers_by_camera_and_joint(world: Any) -> None:
    residual_px = np.full((3, 2, 4, 21), 2.0)
    residual_px[:, :, 1] = 5.0
    residual_px[0, 0, 1, 3], is_inlier = 400.0, np.full((3, 2, 4, 21), True)
    is_inlier[0, 0, 1, 3] = False
    is_inlier[:, :, 3], residual_px[:, :, 3] = False, np.nan
    cells = _run(world, residuals=_residuals(residual_px, is_inlier))
    table = "reprojection of 2D + triangulation, median (px)"
    assert cells[table, "thumb_tip", "a"] == (2.0, 6)
    assert cells[table, "thumb_cmc", "b"] == (5.0, 5)
    assert cells[table, "all joints", "b"] == (5.0, 6 * 21 - 1)
    value, n = cells[table, "all joints", "d"]
    assert np.isnan(value) and n == 0


def test_wrists_are_counted_in_the_hand_and_in_the_body(world: Any) -> None:
    points = np.broadcast_to(FLAT_MM, (4, 2, 21, 3)).copy()
    points[0, 0, WRIST] = np.nan
    residual_px, is_inlier = np.full((4, 2, 4, 21), 9.0), np.full((4, 2, 4, 21), True)
    residual_px[:, 0, :, WRIST] = 3.0
    is_inlier[0, 0] = False
    body_mm = world.body_mm.copy()
    body_mm[[1, 2, 3, 5, 6, 7], ARMS["left"].wrist] = np.nan  # every fourth frame was looked at, and frame 9
    body_mm[8, ARMS["left"].wrist] = np.nan
    skipped = [1, 2, 3, 5, 6, 7]
    cells = _run(
        world,
        joints=_joints(points),
        residuals=_residuals(residual_px, is_inlier),
        bodies=_bodies(body_mm, skipped),
    )
    assert cells["wrist", "right", "coverage (%)"] == (75.0, 4)
    assert cells["wrist", "right", "median reprojection of 2D + triangulation (px)"] == (3.0, 12)
    assert cells["wrist", "left", "median reprojection of 2D + triangulation (px)"] == (9.0, 16)
    assert cells["wrist", "right", "coverage of the body's (%)"] == (100.0, 6)
    assert cells["wrist", "left", "coverage of the body's (%)"] == (pytest.approx(100 * 5 / 6), 6)


def test_bones_have_their_length_and_their_robust_spread(world: Any) -> None:
    """Scaled by 0.9, 1, 1.1 and once by 7: each bone's median stays within the first three, the 7 is no spread."""
    scale = np.array([0.9, 1.0, 1.0, 1.1, 7.0])
    points = FLAT_MM * scale[:, None, None, None] * np.ones((1, 2, 1, 1))
    points[0, 1] = np.nan
    cells = _run(world, joints=_joints(points))
    index_mm = np.array([30.0, 30.0, 30.0, np.hypot(100, 20)])
    assert cells["hand bones (mm)", "index", "right median"] == (pytest.approx(index_mm.mean(), rel=1e-6), 20)
    # Deviations from the median in units of the length: 0.1, 0, 0, 0.1, 6: their median is 0.1.
    assert cells["hand bones (mm)", "index", "right spread"][0] == pytest.approx(0.14826 * index_mm.mean(), rel=1e-5)
    # Left: 1, 1, 1.1, 7 has the median 1.05 and deviations 0.05, 0.05, 0.05, 5.95.
    assert cells["hand bones (mm)", "index", "left median"] == (pytest.approx(1.05 * index_mm.mean(), rel=1e-6), 16)
    assert cells["hand bones (mm)", "index", "left spread"][0] == pytest.approx(0.07413 * index_mm.mean(), rel=1e-5)
    bases_mm = [np.hypot(100, 20 * finger) for finger in range(5)]
    whole = cells["hand bones (mm)", "all fingers", "right median"]
    assert whole == (pytest.approx((15 * 30 + sum(bases_mm)) / 20, rel=1e-6), 100)


def test_forearms_have_mean_and_sd(world: Any) -> None:
    body_mm = world.body_mm[:4].copy()
    elbow, wrist = ARMS["right"].elbow, ARMS["right"].wrist
    body_mm[:, wrist] = body_mm[:, elbow] + np.array([[250.0, 0, 0], [0, 270.0, 0], [0, 0, 260.0], [0, 0, np.nan]])
    cells = _run(world, bodies=_bodies(body_mm))
    assert cells["forearm (mm)", "right", "mean"] == (pytest.approx(260.0, abs=1e-4), 3)
    assert cells["forearm (mm)", "right", "sd"] == (pytest.approx(np.sqrt(200 / 3), rel=1e-5), 3)


def test_a_late_view_and_one_that_looks_elsewhere_are_told(world: Any, walk: Any) -> None:
    world.body_mm = walk(60)
    cells = _run(world, body_keypoints=_seen(world, late={"b": 3}))
    late = {name: cells["agreement of views", name, "late by (frames)"][0] for name in "abcd"}
    assert late == {"a": 0.0, "b": 3.0, "c": 0.0, "d": 0.0}
    assert cells["agreement of views", "b", "error without delay (px)"][0] < 0.1
    assert cells["agreement of views", "b", "error as recorded (px)"][0] > 1.0
    cells = _run(world, body_keypoints=_seen(world, off_px={"c": np.array([6.0, -4.0])}))
    assert cells["agreement of views", "c", "late by (frames)"] == (0.0, 60)
    assert cells["agreement of views", "c", "offset right (px)"][0] == pytest.approx(6.0, abs=0.5)
    assert cells["agreement of views", "c", "offset down (px)"][0] == pytest.approx(-4.0, abs=0.5)


def test_views_are_compared_in_the_middle_of_a_long_sequence(world: Any, walk: Any) -> None:
    world.body_mm = walk(60)
    early = _seen(world, late={"b": 3}).to_pylist()
    rows = [a if a["frame"] < 20 else b for a, b in zip(early, _seen(world).to_pylist(), strict=True)]
    config = CONFIG.model_copy(update={"num_sync_frames": 20})
    cells = _run(world, config, body_keypoints=BODY_KEYPOINTS.from_rows(rows))
    assert cells["agreement of views", "b", "late by (frames)"] == (0.0, 20)
    assert cells["agreement of views", "b", "error as recorded (px)"][0] < 0.1


def test_two_views_are_not_compared(world: Any) -> None:
    world.cameras = world.cameras[:2]
    residuals = _residuals(np.full((2, 2, 2, 21), 1.0), np.full((2, 2, 2, 21), True))
    cells = _run(world, body_keypoints=_seen(world), residuals=residuals)
    assert not [key for key in cells if key[0] == "agreement of views"]
    assert cells["reprojection of 2D + triangulation, median (px)", "all joints", "b"] == (1.0, 84)


def test_nothing_at_all_gives_holes_not_errors(world: Any) -> None:
    num_frames = len(world.body_mm)
    nothing = np.full((2, 2, 21, 3), np.nan)
    unseen = [
        row | {"body_px": np.full(34, np.nan), "confidence": np.zeros(17), "valid": False, "reason": "no_detection"}
        for row in _seen(world).to_pylist()
    ]
    cells = _run(
        world,
        joints=_joints(nothing),
        residuals=_residuals(np.full((2, 2, 4, 21), np.nan), np.full((2, 2, 4, 21), False)),
        bodies=_bodies(np.full((num_frames, 17, 3), np.nan)),
        body_keypoints=BODY_KEYPOINTS.from_rows(unseen),
    )
    assert cells["joints by outcome (%)", "too_few_views", "right"] == (100.0, 42)
    assert cells["wrist", "left", "coverage (%)"] == (0.0, 2)
    assert cells["wrist", "left", "coverage of the body's (%)"] == (0.0, num_frames)
    for key in [
        ("wrist", "left", "median reprojection of 2D + triangulation (px)"),
        ("hand bones (mm)", "thumb", "left median"),
        ("hand bones (mm)", "all fingers", "right spread"),
        ("forearm (mm)", "right", "mean"),
        ("forearm (mm)", "right", "sd"),
        ("agreement of views", "a", "error as recorded (px)"),
        ("agreement of views", "a", "late by (frames)"),
    ]:
        assert np.isnan(cells[key][0]), key


def test_empty_tables_and_sequences_shorter_than_the_shifts(world: Any) -> None:
    empty = {"joints": JOINTS.empty(), "residuals": RESIDUALS.empty(), "bodies": BODIES.empty()}
    cells = _run(world, **empty, body_keypoints=BODY_KEYPOINTS.empty())
    assert np.isnan(cells["wrist", "right", "coverage (%)"][0]) and cells["wrist", "right", "coverage (%)"][1] == 0
    world.body_mm = world.body_mm[:2]
    cells = _run(world)
    assert cells["agreement of views", "a", "error as recorded (px)"][1] == 2
