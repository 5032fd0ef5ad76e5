"""Round 0 from keypoints whose 3D is known exactly."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CORRECTIONS, KEYPOINTS, VIEWS
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens
from assemblyhands_core.hands.joints import JOINT_NAMES
from stages._contract import Context
from stages.triangulate import STAGE, TriangulateConfig

CONFIG = TriangulateConfig(
    max_reprojection_px=20.0, min_confidence=0.1, min_views=2, min_parallax_rad=0.01, max_span_mm=250.0
)
NUM_JOINTS = 21
DISTANCE_MM = 1000.0


def _camera(name: str, angle_rad: float) -> Camera:
    """A camera on a circle around the origin, looking at it."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, DISTANCE_MM], [0, 0, 0, 1.0]])
    return Camera(name, 640, 480, 500.0, 500.0, 319.5, 239.5, OpenCVLens(k1=-0.1, k2=0.02, p1=1e-3), pose)


CAMERAS = [_camera(name, angle) for name, angle in (("a", 0.0), ("b", 0.8), ("c", -0.9), ("d", 1.5))]
POINTS_MM = np.random.default_rng(0).uniform(-80, 80, (2, 2, NUM_JOINTS, 3))  # frame, hand, joint


def _views(cameras: list[Camera] = CAMERAS, invalid: str = "") -> pa.Table:
    rows = []
    for camera in cameras:
        is_valid = camera.camera_id != invalid
        columns = camera_to_row(camera) if is_valid else missing_camera_row()
        row = {"sequence_id": "s", "camera_id": camera.camera_id, "video_file": "", "video_sha256": ""}
        row |= {"num_frames": 2, "rate_hz": 30.0, "image_fit": "same", "note": "", **columns}
        rows.append(row | {"valid": is_valid, "reason": "" if is_valid else "missing_video"})
    return VIEWS.from_rows(rows)


def _observe() -> tuple[np.ndarray, np.ndarray]:
    """Exact keypoints (frame, hand, view, joint, 2) and confidence (frame, hand, view, joint)."""
    pixels = np.stack([camera.project(POINTS_MM) for camera in CAMERAS], axis=2)
    return pixels, np.ones(pixels.shape[:-1])


def _keypoints(pixels: np.ndarray, confidence: np.ndarray) -> pa.Table:
    rows = []
    for f in range(2):
        for h, hand in enumerate(("right", "left")):
            for v, camera in enumerate(CAMERAS):
                is_seen = bool((confidence[f, h, v] > 0).any())
                row = {"sequence_id": "s", "frame": 7 + f, "hand": hand, "camera_id": camera.camera_id}
                row |= {"keypoints_px": pixels[f, h, v].ravel(), "confidence": confidence[f, h, v], "source": "test"}
                rows.append(row | {"valid": is_seen, "reason": "" if is_seen else "no_detection"})
    return KEYPOINTS.from_rows(rows)


def _run(keypoints: pa.Table, views: pa.Table | None = None, config: TriangulateConfig = CONFIG) -> dict[str, pa.Table]:
    inputs = {"views": _views() if views is None else views, "keypoints": keypoints}
    return dict(STAGE.run(config, inputs, Context(Path(), "s")))


def _column(table: pa.Table, name: str) -> np.ndarray:
    return to_numpy(table.column(name))


def test_exact_keypoints_give_the_points_back() -> None:
    tables = _run(_keypoints(*_observe()))
    joints = tables["joints"]
    assert joints.column("frame").to_pylist() == [7, 7, 8, 8]
    assert joints.column("hand").to_pylist() == ["right", "left"] * 2
    error_mm = np.abs(_column(joints, "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3) - POINTS_MM)
    assert error_mm.max() < 1e-3  # keypoints are stored in float32: 3e-5 px are 6e-5 mm here
    assert _column(joints, "valid").all() and (_column(joints, "num_views") == 4).all()
    assert (_column(joints, "reason") == "").all()
    assert _column(joints, "reprojection_px").max() < 1e-3
    assert set(joints.column("source").to_pylist()) == {"2d_triangulation"}
    assert set(joints.column("round").to_pylist()) == {0}
    assert _column(tables["residuals"], "is_inlier").all()


def test_one_view_that_is_far_off_is_left_out_and_told() -> None:
    pixels, confidence = _observe()
    pixels[0, 1, 2, 5] += (30.0, 40.0)
    tables = _run(_keypoints(pixels, confidence))
    joints, residuals = tables["joints"], tables["residuals"]
    error_mm = np.abs(_column(joints, "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3) - POINTS_MM)
    assert error_mm.max() < 1e-3
    num_views = _column(joints, "num_views").reshape(2, 2, NUM_JOINTS)
    assert num_views[0, 1, 5] == 3 and (num_views == 4).sum() == num_views.size - 1
    residual_px = _column(residuals, "residual_px").reshape(2, 2, 4, NUM_JOINTS)
    is_inlier = _column(residuals, "is_inlier").reshape(2, 2, 4, NUM_JOINTS)
    assert residual_px[0, 1, 2, 5] == pytest.approx(50.0, abs=1e-2)
    assert not is_inlier[0, 1, 2, 5] and is_inlier.sum() == is_inlier.size - 1
    # The mean is over the inliers: the outlier's 50 px do not enter it.
    assert _column(joints, "reprojection_px").reshape(2, 2, NUM_JOINTS)[0, 1, 5] < 1e-3


def test_each_way_to_fail_has_its_reason() -> None:
    pixels, confidence = _observe()
    confidence[0, 0, :, 0] = 0.0  # nobody saw it
    confidence[0, 0, 1:, 1] = 0.0  # one view saw it
    confidence[0, 0, :, 2] = 0.05  # seen, but below min_confidence
    pixels[0, 0, :2, 3], confidence[0, 0, 2:, 3] = [(320, 20), (320, 460)], 0.0  # one says far up, the other far down
    pixels[0, 0, :, 4] = np.nan
    joints = _run(_keypoints(pixels, confidence))["joints"]
    reasons = _column(joints, "reason").reshape(2, 2, NUM_JOINTS)
    expected = ["no_detection", "too_few_views", "no_detection", "high_reprojection", "no_detection"]
    assert reasons[0, 0, :5].tolist() == expected
    assert (reasons[0, 0, 5:] == "").all() and (reasons[1] == "").all()
    points = _column(joints, "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3)
    valid = _column(joints, "valid").reshape(2, 2, NUM_JOINTS).astype(bool)
    assert valid.sum() == valid.size - 5
    assert np.isnan(points[~valid]).all() and np.isfinite(points[valid]).all()
    assert np.isnan(_column(joints, "reprojection_px").reshape(2, 2, NUM_JOINTS)[~valid]).all()


def test_min_views_asks_for_more_agreement() -> None:
    pixels, confidence = _observe()
    confidence[0, 0, 2:, 0] = 0.0
    keypoints = _keypoints(pixels, confidence)
    strict = _run(keypoints, config=CONFIG.model_copy(update={"min_views": 3}))["joints"]
    assert _column(_run(keypoints)["joints"], "reason").reshape(2, 2, NUM_JOINTS)[0, 0, 0] == ""
    assert _column(strict, "reason").reshape(2, 2, NUM_JOINTS)[0, 0, 0] == "too_few_views"


def test_a_view_that_cannot_be_used_keeps_its_rows_and_changes_nothing() -> None:
    pixels, confidence = _observe()
    pixels[:, :, 3] += 200.0
    keypoints = _keypoints(pixels, confidence)
    tables = _run(keypoints, views=_views(invalid="d"))
    assert (_column(tables["joints"], "num_views") == 3).all()
    assert tables["residuals"].num_rows == keypoints.num_rows
    of_d = _column(tables["residuals"], "camera_id") == "d"
    assert np.isnan(_column(tables["residuals"], "residual_px")[of_d]).all()
    assert np.isfinite(_column(tables["residuals"], "residual_px")[~of_d]).all()
    assert not _column(tables["residuals"], "is_inlier")[of_d].any()


def test_rows_marked_invalid_are_not_used() -> None:
    pixels, confidence = _observe()
    keypoints = _keypoints(pixels, confidence)
    valid = np.array(keypoints.column("camera_id").to_pylist()) != "a"
    keypoints = keypoints.set_column(keypoints.schema.get_field_index("valid"), "valid", pa.array(valid))
    assert (_column(_run(keypoints)["joints"], "num_views") == 3).all()


def test_the_order_of_rows_and_of_views_does_not_matter() -> None:
    keypoints = _keypoints(*_observe())
    order = np.random.default_rng(1).permutation(keypoints.num_rows)
    straight, shuffled = _run(keypoints), _run(keypoints.take(order))
    assert straight["joints"].equals(shuffled["joints"])
    assert straight["residuals"].take(order).equals(shuffled["residuals"])
    turned = _run(keypoints, views=_views(CAMERAS[::-1]))
    assert np.allclose(
        _column(straight["joints"], "joints_world_mm"), _column(turned["joints"], "joints_world_mm"), atol=1e-3
    )


def test_no_rows_give_empty_tables() -> None:
    tables = _run(KEYPOINTS.empty())
    assert {name: table.num_rows for name, table in tables.items()} == {"joints": 0, "residuals": 0}


def test_a_joint_far_from_its_hand_is_none_of_it() -> None:
    """All views agree on it, so that only the other joints can tell."""
    pixels, confidence = _observe()
    far_mm, near_mm = np.array([0.0, 290.0, 0.0]), np.array([0.0, -220.0, 0.0])
    pixels[1, 0, :, 6] = [camera.project(far_mm) for camera in CAMERAS]
    pixels[1, 1, :, 6] = [camera.project(near_mm) for camera in CAMERAS]
    tables = _run(_keypoints(pixels, confidence))
    reason = _column(tables["joints"], "reason").reshape(2, 2, NUM_JOINTS)
    assert reason[1, 0, 6] == "outside_hand" and (reason == "").sum() == reason.size - 1
    points = _column(tables["joints"], "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3)
    assert np.isnan(points[1, 0, 6]).all() and np.isfinite(points).all(axis=-1).sum() == reason.size - 1
    is_hand = np.array(tables["residuals"].column("hand").to_pylist()) == "right"
    of_frame = (np.array(tables["residuals"].column("frame").to_pylist()) == 8) & is_hand
    assert np.isnan(_column(tables["residuals"], "residual_px")[of_frame, 6]).all()
    assert not _column(tables["residuals"], "is_inlier")[of_frame, 6].any()
    wide = _run(_keypoints(pixels, confidence), config=CONFIG.model_copy(update={"max_span_mm": 400.0}))["joints"]
    assert (_column(wide, "reason") == "").all()


def test_a_lone_joint_is_its_own_hand() -> None:
    pixels, confidence = _observe()
    confidence[:, :, :, :20] = 0.0
    joints = _run(_keypoints(pixels, confidence), config=CONFIG.model_copy(update={"max_span_mm": 1.0}))["joints"]
    assert (_column(joints, "valid").reshape(-1, NUM_JOINTS) == (np.arange(NUM_JOINTS) == 20)).all()


def _corrected(
    keypoints: pa.Table, *points: tuple[int, str, str, int, tuple[float, float] | None]
) -> dict[str, pa.Table]:
    """Run with corrections: frame, hand, camera, joint, and where it is or None where it is not seen."""
    rows = [
        {"sequence_id": "s", "frame": frame, "hand": hand, "camera_id": camera, "joint": JOINT_NAMES[joint]}
        | {"corrected_px": place or (np.nan, np.nan), "visibility": 2 if place else 0, "weight": 10.0}
        for frame, hand, camera, joint, place in points
    ]
    inputs = {"views": _views(), "keypoints": keypoints, "corrections": CORRECTIONS.from_rows(rows)}
    return dict(STAGE.run(CONFIG, inputs, Context(Path(), "s")))


def _true_px(view: int, frame: int, hand: int, joint: int) -> tuple[float, float]:
    x, y = CAMERAS[view].project(POINTS_MM[frame, hand, joint])
    return float(x), float(y)


def test_two_people_outvote_two_detectors_and_the_row_says_so() -> None:
    """Views c and d agree on another point; so do a and b, once somebody has set the joint there."""
    pixels, confidence = _observe()
    elsewhere_mm = POINTS_MM[0, 1, 5] + (60.0, 40.0, 0.0)
    for view, camera in enumerate(CAMERAS):
        pixels[0, 1, view, 5] = camera.project(elsewhere_mm)
    keypoints = _keypoints(pixels, confidence)
    wrong_mm = _column(_run(keypoints)["joints"], "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3)[0, 1, 5]
    assert np.linalg.norm(wrong_mm - elsewhere_mm) < 1e-2
    tables = _corrected(keypoints, *((7, "left", name, 5, _true_px(v, 0, 1, 5)) for v, name in enumerate("ab")))
    joints = tables["joints"]
    error_mm = np.linalg.norm(_column(joints, "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3) - POINTS_MM, axis=-1)
    assert error_mm.max() < 0.5  # what detectors say within twice the threshold has a weight of 1 to 100 still
    assert joints["source"].to_pylist() == ["2d_triangulation", "manual", "2d_triangulation", "2d_triangulation"]
    is_inlier = _column(tables["residuals"], "is_inlier").reshape(2, 2, 4, NUM_JOINTS)
    assert is_inlier[0, 1, :, 5].tolist() == [True, True, False, False]
    assert tables["residuals"].num_rows == keypoints.num_rows


def test_what_somebody_says_is_not_seen_does_not_count() -> None:
    pixels, confidence = _observe()
    keypoints = _keypoints(pixels, confidence)
    joints = _corrected(keypoints, *((7, "right", name, 3, None) for name in "abc"))["joints"]
    reasons = _column(joints, "reason").reshape(2, 2, NUM_JOINTS)
    assert reasons[0, 0, 3] == "too_few_views" and (reasons != "").sum() == 1


def test_a_joint_that_people_hold_is_never_a_stray() -> None:
    """All other joints of the hand were found 300 mm away."""
    pixels, confidence = _observe()
    for view, camera in enumerate(CAMERAS):
        pixels[0, 0, view] = camera.project(POINTS_MM[0, 0] + (0.0, 300.0, 0.0))
    keypoints = _keypoints(pixels, confidence)
    places = {view: (7, "right", "abcd"[view], 2, _true_px(view, 0, 0, 2)) for view in (0, 1)}
    joints = _corrected(keypoints, *places.values())["joints"]
    found_mm = _column(joints, "joints_world_mm").reshape(2, 2, NUM_JOINTS, 3)[0, 0, 2]
    assert np.linalg.norm(found_mm - POINTS_MM[0, 0, 2]) < 1e-2


def test_a_view_without_a_row_gets_one_from_a_correction() -> None:
    keypoints = _keypoints(*_observe())
    few = keypoints.filter(~(np.arange(keypoints.num_rows) < 3))  # of the first hand, view d alone
    tables = _corrected(few, (7, "right", "a", 0, _true_px(0, 0, 0, 0)))
    assert tables["residuals"].num_rows == few.num_rows + 1
    valid = _column(tables["joints"], "valid").reshape(2, 2, NUM_JOINTS)
    assert valid[0, 0].tolist() == [True] + [False] * 20


def test_without_corrections_nothing_changes() -> None:
    keypoints = _keypoints(*_observe())
    assert all(table.equals(_run(keypoints)[name]) for name, table in _corrected(keypoints).items())
