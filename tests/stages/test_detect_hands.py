"""Hand boxes against the closed form, in a world where everything is known."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.hands.body import ARMS, BODY_KEYPOINT_NAMES
from stages._contract import Context
from stages.detect_hands import STAGE, DetectHandsConfig

RADIUS_MM = 130.0
CONFIG = DetectHandsConfig(
    detector="exact",
    options={"exact": {}},
    every_nth_frame=1,
    max_image_side_px=1280,
    max_persons=3,
    association_px=40.0,
    max_reprojection_px=25.0,
    max_gap_frames=3,
    hand_radius_mm=RADIUS_MM,
)
WRISTS = tuple(BODY_KEYPOINT_NAMES.index(f"{hand}_wrist") for hand in ("right", "left"))


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, world: Any) -> Callable[..., dict[str, pa.Table]]:
    """Return the stage, run with a detector on the world or a part of it."""

    def run_stage(detector: Any, chunk: pa.Table | None = None, unusable: Any = None, **how: Any) -> dict[str, Any]:
        monkeypatch.setattr("stages.detect_hands.create_body_detector", lambda name, **options: detector)
        views = world.views(unusable)
        inputs = {
            "chunks": world.chunk() if chunk is None else chunk,
            "views": views,
            "rectified_views": how.pop("rectified", None) or world.rectified(views),
        }
        return dict(STAGE.run(CONFIG.model_copy(update=how), inputs, Context(Path(), "s")))

    return run_stage


def _center_mm(body_mm: np.ndarray, hand: Any) -> np.ndarray:
    wrist, elbow = body_mm[:, ARMS[hand].wrist], body_mm[:, ARMS[hand].elbow]
    return wrist + (wrist - elbow) / 3


def _column(table: pa.Table, name: str) -> np.ndarray:
    return to_numpy(table.column(name))


def _of(boxes: pa.Table, hand: str, camera_id: str) -> list[dict[str, Any]]:
    rows = [row for row in boxes.to_pylist() if (row["hand"], row["camera_id"]) == (hand, camera_id)]
    return sorted(rows, key=lambda row: row["frame"])


def test_boxes_are_those_of_the_closed_form(run: Any, world: Any, exact_bodies: Any) -> None:
    boxes = run(exact_bodies())["hand_boxes"]
    assert boxes.num_rows == len(world.body_mm) * 2 * len(world.cameras)
    rectified = valid_cameras(world.rectified(world.views()))
    for hand in ("right", "left"):
        center_mm = _center_mm(world.body_mm, hand)
        for name, camera in rectified.items():
            rows = _of(boxes, hand, name)
            assert [row["frame"] for row in rows] == list(range(len(world.body_mm)))
            assert {(row["valid"], row["reason"], row["source"]) for row in rows} == {(True, "", "detected")}
            depth_mm = (camera.T_camera_from_world[2] @ np.c_[center_mm, np.ones(len(center_mm))].T).T
            in_camera = (camera.T_camera_from_world[:3] @ np.c_[center_mm, np.ones(len(center_mm))].T).T
            pinhole_px = 500.0 * in_camera[:, :2] / in_camera[:, 2:] + np.array([319.5, 239.5])
            np.testing.assert_allclose([row["center_rectified_px"] for row in rows], pinhole_px, atol=2e-4)
            np.testing.assert_allclose([row["side_px"] for row in rows], 2 * RADIUS_MM * 500.0 / depth_mm, rtol=1e-6)
            np.testing.assert_allclose([row["hand_center_world_mm"] for row in rows], center_mm, atol=1e-3)


def test_the_body_is_the_worlds_in_every_view_and_in_3d(run: Any, world: Any, exact_bodies: Any) -> None:
    tables = run(exact_bodies())
    body_mm = _column(tables["bodies"], "body_world_mm").reshape(-1, 17, 3)
    np.testing.assert_allclose(body_mm, world.body_mm, atol=1e-3)
    assert (_column(tables["bodies"], "num_views") == len(world.cameras)).all()
    seen = tables["body_keypoints"].to_pylist()
    assert len(seen) == len(world.body_mm) * len(world.cameras)
    for camera in world.cameras:
        rows = [row for row in seen if row["camera_id"] == camera.camera_id]
        pixels = np.array([row["body_px"] for row in rows]).reshape(-1, 17, 2)
        np.testing.assert_allclose(pixels, camera.project(world.body_mm), atol=1e-4)
        assert {(row["valid"], row["reason"], row["num_persons"]) for row in rows} == {(True, "", 1)}
    assert tables["followed"].to_pylist()[0]["note"].startswith("followed the only person: seen in 4.0 of 4 views")


def test_short_gaps_are_interpolated_and_say_so_long_ones_stay_holes(run: Any, world: Any, exact_bodies: Any) -> None:
    hidden = {"right_wrist": range(4, 7), "left_wrist": range(4, 8)}  # three frames are filled, four are not

    def is_hidden(camera_id: str, frame: int) -> list[int]:
        return [BODY_KEYPOINT_NAMES.index(name) for name, frames in hidden.items() if frame in frames]

    boxes = run(exact_bodies(is_hidden=is_hidden))["hand_boxes"]
    right, left = _of(boxes, "right", "a"), _of(boxes, "left", "a")
    assert [row["source"] for row in right] == ["detected"] * 4 + ["interpolated"] * 3 + ["detected"] * 5
    assert all(row["valid"] for row in right)
    ends = _center_mm(world.body_mm, "right")[[3, 7]]
    np.testing.assert_allclose(right[4]["hand_center_world_mm"], ends[0] + (ends[1] - ends[0]) / 4, atol=1e-3)
    assert [row["source"] for row in left] == ["detected"] * 4 + [""] * 4 + ["detected"] * 4
    assert [row["reason"] for row in left] == [""] * 4 + ["no_detection"] * 4 + [""] * 4
    assert np.isnan([row["side_px"] for row in left[4:8]]).all()
    assert np.isnan([row["hand_center_world_mm"] for row in left[4:8]]).all()


@pytest.mark.parametrize("first", [0, 1])
def test_skipped_frames_are_interpolated_to_the_last_one(run: Any, world: Any, exact_bodies: Any, first: int) -> None:
    detector = exact_bodies()
    tables = run(detector, world.chunk(first, 11), every_nth_frame=4)
    looked_at = [first + frame for frame in (0, 4, 8, 10)]
    assert sorted({frame for _, frame in detector.asked}) == looked_at
    rows = _of(tables["hand_boxes"], "left", "b")
    assert [row["frame"] for row in rows if row["source"] == "detected"] == looked_at
    assert {row["source"] for row in rows} == {"detected", "interpolated"} and all(row["valid"] for row in rows)
    skipped = {row["frame"] for row in tables["body_keypoints"].to_pylist() if row["reason"] == "skipped_frame"}
    assert skipped == set(range(first, first + 11)) - set(looked_at)
    reasons = _column(tables["bodies"], "reason")
    assert (reasons[1:4] == "skipped_frame").all() and (reasons[[0, 4, 8, 10]] == "").all()


def test_gaps_that_skipping_makes_must_be_filled() -> None:
    with pytest.raises(ValidationError, match="every_nth_frame leaves longer gaps"):
        DetectHandsConfig.model_validate({**CONFIG.model_dump(), "every_nth_frame": 5, "max_gap_frames": 3})
    DetectHandsConfig.model_validate({**CONFIG.model_dump(), "every_nth_frame": 4, "max_gap_frames": 3})


def test_a_view_that_cannot_be_used_keeps_its_rows_and_its_reason(run: Any, world: Any, exact_bodies: Any) -> None:
    tables = run(exact_bodies(), unusable={"c": "missing_video"})
    assert tables["hand_boxes"].num_rows == len(world.body_mm) * 2 * len(world.cameras)
    for name in ("hand_boxes", "body_keypoints"):
        rows = tables[name].to_pylist()
        assert {row["reason"] for row in rows if row["camera_id"] == "c"} == {"missing_video"}
        assert all(row["valid"] != (row["camera_id"] == "c") for row in rows)
    assert (_column(tables["bodies"], "num_views") == 3).all()


def test_a_view_without_rectification_still_sees_the_body(run: Any, world: Any, exact_bodies: Any) -> None:
    rectified = world.rectified(world.views({"c": "high_residual"}))
    tables = run(exact_bodies(), rectified=rectified)
    assert (_column(tables["bodies"], "num_views") == 4).all()
    assert all(row["valid"] for row in tables["body_keypoints"].to_pylist())
    assert {row["reason"] for row in tables["hand_boxes"].to_pylist() if row["camera_id"] == "c"} == {"high_residual"}


def test_two_views_are_enough(run: Any, world: Any, exact_bodies: Any) -> None:
    tables = run(exact_bodies(), unusable={"b": "missing_video", "c": "unreadable_video"})
    np.testing.assert_allclose(_column(tables["bodies"], "body_world_mm").reshape(-1, 17, 3), world.body_mm, atol=1e-3)
    assert sum(row["valid"] for row in tables["hand_boxes"].to_pylist()) == len(world.body_mm) * 2 * 2


def test_nobody_is_a_reason_everywhere(run: Any, world: Any, exact_bodies: Any) -> None:
    tables = run(exact_bodies(is_hidden=lambda camera_id, frame: range(17)))
    assert {row["reason"] for row in tables["hand_boxes"].to_pylist()} == {"no_detection"}
    assert {row["reason"] for row in tables["body_keypoints"].to_pylist()} == {"no_detection"}
    assert (_column(tables["bodies"], "reason") == "too_few_views").all()
    followed = tables["followed"].to_pylist()[0]
    assert followed["num_persons"] == 0 and followed["note"] == "followed nobody: no person fits two views"


@pytest.mark.parametrize("count", [0, 1])
def test_chunks_of_one_frame_and_of_none(run: Any, world: Any, exact_bodies: Any, count: int) -> None:
    tables = run(exact_bodies(), world.chunk(7, count))
    assert tables["hand_boxes"].num_rows == count * 2 * len(world.cameras)
    assert tables["body_keypoints"].num_rows == count * len(world.cameras)
    assert tables["bodies"].column("frame").to_pylist() == [7] * count
    assert all(row["valid"] for row in tables["hand_boxes"].to_pylist())


def test_frames_are_those_of_the_chunk_whatever_its_place(run: Any, world: Any, exact_bodies: Any) -> None:
    whole = run(exact_bodies())["hand_boxes"]
    parts = [run(exact_bodies(), world.chunk(first, 4))["hand_boxes"] for first in (0, 4, 8)]
    assert pa.concat_tables(parts).equals(whole)


def test_a_view_that_sees_the_person_elsewhere_says_that_it_does_not_fit(
    run: Any, world: Any, exact_bodies: Any
) -> None:
    tables = run(exact_bodies(offset_px={"d": (0.0, 120.0)}))
    rows = tables["body_keypoints"].to_pylist()
    assert {row["reason"] for row in rows if row["camera_id"] == "d"} == {"not_associated"}
    assert {row["num_persons"] for row in rows} == {1}
    assert (_column(tables["bodies"], "num_views") == 3).all()
    assert all(row["valid"] for row in tables["hand_boxes"].to_pylist())  # the others tell where the hand is


def test_of_two_persons_the_one_seen_more_is_followed(run: Any, world: Any, exact_bodies: Any) -> None:
    passer_by = world.body_mm + np.array([900.0, 0.0, 500.0])
    passer_by[8:] += 1e5
    tables = run(exact_bodies(passer_by))
    np.testing.assert_allclose(_column(tables["bodies"], "body_world_mm").reshape(-1, 17, 3), world.body_mm, atol=1e-3)
    followed = tables["followed"].to_pylist()[0]
    assert followed["num_persons"] == 2 and followed["note"].startswith("followed person 1 of 2")


def test_hands_outside_a_view_and_behind_it_are_told_apart(run: Any, world: Any, exact_bodies: Any) -> None:
    a, b = world.cameras[:2]
    aside = np.array([[1, 0, 0, 1900.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    back = np.array([[-1, 0, 0, 0.0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    world.cameras[2] = a.moved(aside @ a.T_camera_from_world)
    world.cameras[3] = b.moved(back @ b.T_camera_from_world)
    world.cameras[2:] = [
        type(a)(name, *[getattr(camera, part) for part in list(vars(camera))[1:]])
        for name, camera in zip("cd", world.cameras[2:], strict=True)
    ]
    boxes = run(exact_bodies())["hand_boxes"].to_pylist()
    reasons = {name: {row["reason"] for row in boxes if row["camera_id"] == name} for name in "abcd"}
    assert reasons == {"a": {""}, "b": {""}, "c": {"outside_view"}, "d": {"behind_camera"}}
    holes = [row for row in boxes if not row["valid"]]
    assert np.isnan([row["center_rectified_px"] for row in holes]).all()
    assert np.isfinite([row["hand_center_world_mm"] for row in holes]).all()
