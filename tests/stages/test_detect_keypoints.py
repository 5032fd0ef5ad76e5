"""Keypoints of hands whose place is known, found in crops or read without them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import BODY_KEYPOINTS, CROPS, KEYPOINTS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.detectors.base import HandDetection
from assemblyhands_core.geometry.crops import crop_camera, rectified
from assemblyhands_core.hands.body import ARMS
from stages._contract import Context
from stages.detect_keypoints import STAGE, DetectKeypointsConfig

CONFIG = DetectKeypointsConfig(detector="exact", options={"exact": {}}, wrist_from_body=True)
JOINTS_MM = np.random.default_rng(3).uniform(-80, 80, (21, 3)) + np.array([-300.0, 150.0, 0.0])
CENTER_MM = np.array([-300.0, 150.0, 0.0])
CROP_PX = 96


@dataclass
class ExactHand:
    """A hand detector that knows each crop by its grey value and returns what is stored for it."""

    found: dict[int, HandDetection | None]
    needs_image: bool = True
    asked: list[Any] = field(default_factory=list)

    def detect(self, image_rgb: Any, hand: str, camera_id: str, frame: int, expected_px: Any = None) -> Any:
        self.asked.append((hand, camera_id, frame, expected_px))
        return self.found[0 if image_rgb is None else round(float(image_rgb.mean()))]


def _crop_camera(camera: Any) -> Any:
    whole = rectified(camera)
    return crop_camera(whole, whole.project(CENTER_MM), 60.0, CROP_PX)


def _crops(world: Any, **holes: str) -> pa.Table:
    """One frame's crops of the right hand in all views, grey 100 and up; ``holes`` gives the reasons of some."""
    rows = []
    for v, camera in enumerate(world.cameras):
        reason = holes.get(camera.camera_id, "")
        image = encode_jpeg(np.full((CROP_PX, CROP_PX, 3), 100 + v, np.uint8), 100)
        row = {"sequence_id": "s", "frame": 5, "hand": "right", "camera_id": camera.camera_id}
        row |= missing_camera_row() if reason else camera_to_row(_crop_camera(camera))
        rows.append(row | {"image": b"" if reason else image, "valid": not reason, "reason": reason})
    return CROPS.from_rows(rows)


def _body(world: Any, **unseen: str) -> pa.Table:
    """The body in the same frame."""
    rows = []
    for camera in world.cameras:
        reason = unseen.get(camera.camera_id, "")
        pixels = np.full((17, 2), np.nan) if reason else camera.project(world.body_mm[5])
        row = {"sequence_id": "s", "frame": 5, "camera_id": camera.camera_id, "body_px": pixels.ravel()}
        row |= {"confidence": np.full(17, 0.0 if reason else 0.7), "num_persons": 1}
        rows.append(row | {"valid": not reason, "reason": reason})
    return BODY_KEYPOINTS.from_rows(rows)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, world: Any) -> Callable[..., list[dict[str, Any]]]:
    """Return the stage, run with a detector and some of its inputs replaced."""

    def run_stage(detector: Any, **how: Any) -> list[dict[str, Any]]:
        monkeypatch.setattr("stages.detect_keypoints.create_hand_detector", lambda name, **options: detector)
        inputs = {
            "views": how.pop("views", None) or world.views(),
            "crops": how.pop("crops", None) or _crops(world),
            "body_keypoints": how.pop("body", None) or _body(world),
        }
        table = STAGE.run(CONFIG.model_copy(update=how), inputs, Context(Path(), "s"))["keypoints"]
        return table.to_pylist()

    return run_stage


def _exact(world: Any) -> ExactHand:
    found = {
        100 + v: HandDetection(_crop_camera(camera).project(JOINTS_MM), np.linspace(0.5, 1, 21))
        for v, camera in enumerate(world.cameras)
    }
    return ExactHand(found)


def _pixels(row: dict[str, Any]) -> np.ndarray:
    return np.array(row["keypoints_px"]).reshape(21, 2)


def test_joints_found_in_crops_are_given_in_the_videos_pixels(run: Any, world: Any) -> None:
    rows = run(_exact(world))
    assert [row["camera_id"] for row in rows] == ["a", "b", "c", "d"]
    for row, camera in zip(rows, world.cameras, strict=True):
        assert (row["valid"], row["reason"], row["source"], row["hand"]) == (True, "", "exact", "right")
        np.testing.assert_allclose(_pixels(row), camera.project(JOINTS_MM), atol=1e-4)  # stored in float32
        np.testing.assert_allclose(row["confidence"], np.linspace(0.5, 1, 21), rtol=1e-6)


def test_where_no_hand_is_found_the_bodys_wrist_stands_for_it(run: Any, world: Any) -> None:
    detector = _exact(world)
    detector.found[101] = None
    row = run(detector)[1]
    assert (row["valid"], row["reason"], row["source"]) == (True, "", "body")
    expected_px = world.cameras[1].project(world.body_mm[5, ARMS["right"].wrist])
    np.testing.assert_allclose(_pixels(row)[20], expected_px, atol=1e-4)
    assert row["confidence"][20] == pytest.approx(0.7) and set(row["confidence"][:20]) == {0.0}
    assert np.isnan(_pixels(row)[:20]).all()


def test_without_hand_and_wrist_the_row_says_why(run: Any, world: Any) -> None:
    detector = _exact(world)
    detector.found[100] = detector.found[101] = None
    rows = run(
        detector, body=_body(world, a="not_associated", c="not_associated"), crops=_crops(world, c="outside_view")
    )
    assert [row["reason"] for row in rows] == ["no_detection", "", "outside_view", ""]
    assert [row["source"] for row in rows] == ["", "body", "", "exact"]
    for row in (rows[0], rows[2]):
        assert not row["valid"] and np.isnan(_pixels(row)).all() and set(row["confidence"]) == {0.0}


def test_the_bodys_wrist_is_taken_only_on_request(run: Any, world: Any) -> None:
    rows = run(_exact(world), crops=_crops(world, b="missing_frame"), wrist_from_body=False)
    assert [row["reason"] for row in rows] == ["", "missing_frame", "", ""]
    assert run(_exact(world), crops=_crops(world, b="missing_frame"))[1]["source"] == "body"


def test_joints_that_the_lens_cannot_show_are_missing_and_none_at_all_is_no_hand(run: Any, world: Any) -> None:
    detector = _exact(world)
    some_px = detector.found[100].keypoints_px.copy()
    some_px[:4] = np.nan
    detector.found[100] = HandDetection(some_px, np.ones(21))
    detector.found[101] = HandDetection(np.full((21, 2), np.nan), np.zeros(21))
    rows = run(detector, wrist_from_body=False)
    assert rows[0]["valid"] and rows[0]["confidence"] == [0.0] * 4 + [1.0] * 17
    assert not rows[1]["valid"] and rows[1]["reason"] == "no_detection"


def test_a_detector_without_images_needs_no_crop_and_is_told_where_the_hand_should_be(run: Any, world: Any) -> None:
    stored = HandDetection(np.arange(42.0).reshape(21, 2), np.ones(21))
    detector = ExactHand({0: stored}, needs_image=False)
    body = _body(world, c="not_associated")
    rows = run(detector, crops=_crops(world, b="missing_frame", c="no_detection"), body=body)
    assert [row["source"] for row in rows] == ["exact"] * 4
    assert all((_pixels(row) == stored.keypoints_px).all() for row in rows)
    expected = {camera_id: expected_px for _, camera_id, _, expected_px in detector.asked}
    for v in (0, 3):  # the crop's middle, in the video
        np.testing.assert_allclose(expected["abcd"[v]], world.cameras[v].project(CENTER_MM), atol=1e-6)
    wrist_px = world.cameras[1].project(world.body_mm[5, ARMS["right"].wrist])
    np.testing.assert_allclose(expected["b"], wrist_px, atol=1e-4)
    assert expected["c"] is None


def test_a_view_that_cannot_be_used_is_not_looked_at(run: Any, world: Any) -> None:
    detector = ExactHand({0: HandDetection(np.ones((21, 2)), np.ones(21))}, needs_image=False)
    reason = {"d": "missing_video"}
    rows = run(detector, views=world.views(reason), crops=_crops(world, **reason), body=_body(world, **reason))
    assert [row["reason"] for row in rows] == ["", "", "", "missing_video"]
    assert {camera_id for _, camera_id, _, _ in detector.asked} == {"a", "b", "c"}


def test_no_crops_give_an_empty_table(run: Any, world: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stages.detect_keypoints.create_hand_detector", lambda name, **options: _exact(world))
    inputs = {"views": world.views(), "crops": CROPS.empty(), "body_keypoints": BODY_KEYPOINTS.empty()}
    table = STAGE.run(CONFIG, inputs, Context(Path(), "s"))["keypoints"]
    assert table.num_rows == 0 and table.schema.equals(KEYPOINTS.schema)
