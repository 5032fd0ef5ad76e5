"""Hands triangulated from a headset's crops by a detector that knows where their joints are."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml
from ego_crops import ego_crops

from assemblyhands_core.data.camera_rows import camera_to_row
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.detectors.base import HandDetection
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from stages._contract import Context
from stages.triangulate_ego import STAGE, TriangulateEgoConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "triangulate_ego.yaml"
NUM_FRAMES = 2
JOINTS_MM = np.random.default_rng(0).uniform(-60, 60, (NUM_FRAMES, 2, NUM_JOINTS, 3)) + np.array([0.0, 0.0, 350.0])


def _camera(frame: int, place: int) -> Camera:
    """One of four cameras side by side and one above the other, of a head that moves by 30 mm a frame."""
    pose = np.eye(4)
    pose[:3, 3] = [70.0 * (place % 2) - 35.0 - 30.0 * frame, 50.0 * (place // 2) - 25.0, 0.0]
    return Camera(f"HMC_{place}", 96, 96, 160.0, 160.0, 47.5, 46.0, Pinhole(), pose)


def _crops(places: Sequence[int] = range(4), is_there: Callable[[int, str, int], bool] = lambda *_: True) -> pa.Table:
    """Return crops of both hands in some cameras; holes where nothing is there."""
    hole, row = ego_crops(4).to_pylist()[3], ego_crops(1).to_pylist()[0]
    rows = []
    for frame in range(NUM_FRAMES):
        for hand in HANDS:
            for place in places:
                name = {"frame": frame, "hand": hand, "camera_id": f"HMC_{place}"}
                found = row | camera_to_row(_camera(frame, place)) if is_there(frame, hand, place) else hole
                rows.append({**found, **name})
    return EGO_CROPS.from_rows(rows)


class _Knowing:
    """A detector that projects the joints, and notes whom it was asked about.

    Attributes:
        spoil: Changes pixels (21, 2) and confidence (21,) of a frame, hand and camera in place; says whether any is
            found.
    """

    needs_image = True

    def __init__(self, spoil: Callable[..., bool] = lambda *_: True) -> None:
        self.spoil = spoil
        self.asked: list[tuple[int, str, str]] = []

    def detect(self, image_rgb: Any, hand: str, camera_id: str, frame: int, expected_px: Any = None) -> Any:
        assert image_rgb.shape == (96, 96, 3) and expected_px is None
        self.asked.append((frame, hand, camera_id))
        place = int(camera_id.removeprefix("HMC_"))
        pixels = _camera(frame, place).project(JOINTS_MM[frame, HANDS.index(hand)])  # type: ignore[arg-type]
        confidence = np.ones(NUM_JOINTS)
        return HandDetection(pixels, confidence) if self.spoil(pixels, confidence, frame, hand, place) else None


def _config(**changes: Any) -> TriangulateEgoConfig:
    values = yaml.safe_load(CONF.read_text()) | {"detector": "mediapipe"} | changes
    return TriangulateEgoConfig.model_validate(values)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[dict[str, Any]]]:
    def run(crops: pa.Table, seeing: Any = None, **changes: Any) -> list[dict[str, Any]]:
        made = seeing or _Knowing()
        monkeypatch.setattr("stages.triangulate_ego.create_hand_detector", lambda name, **options: made)
        joints = STAGE.run(_config(**changes), {"crops": crops}, Context(Path(), "s"))["joints"]
        rows: list[dict[str, Any]] = joints.to_pylist()
        return rows

    return run


Run = Callable[..., list[dict[str, Any]]]


def _points(row: dict[str, Any]) -> np.ndarray:
    return np.reshape(row["joints_world_mm"], (NUM_JOINTS, 3))


def _true(row: dict[str, Any]) -> np.ndarray:
    return JOINTS_MM[row["frame"], HANDS.index(row["hand"])]  # type: ignore[arg-type]


def test_exact_pixels_give_the_joints_back(run: Run) -> None:
    crops, detector = _crops(), _Knowing()
    rows = run(crops.take(list(np.random.default_rng(1).permutation(crops.num_rows))), detector)
    assert [(row["frame"], row["hand"]) for row in rows] == [(0, "left"), (0, "right"), (1, "left"), (1, "right")]
    for row in rows:
        np.testing.assert_allclose(_points(row), _true(row), rtol=0, atol=1e-3)
        assert all(row["valid"]) and set(row["num_views"]) == {4} and set(row["reason"]) == {""}
        assert max(row["reprojection_px"]) < 1e-4
        assert (row["sequence_id"], row["source"], row["round"]) == ("s", "ego_triangulation", 0)
    assert len(detector.asked) == len(set(detector.asked)) == 16


def test_many_crops_are_asked_about_in_parts(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = run(_crops())
    monkeypatch.setattr("stages.triangulate_ego._AT_ONCE", 3)
    assert run(_crops()) == whole


def test_holes_are_not_looked_at_and_leave_the_other_views(run: Run) -> None:
    detector = _Knowing()
    rows = run(_crops(is_there=lambda frame, hand, place: place in (0, 3) or hand == "left"), detector)
    assert all(set(row["num_views"]) == {2 if row["hand"] == "right" else 4} for row in rows)
    for row in rows:
        np.testing.assert_allclose(_points(row), _true(row), rtol=0, atol=1e-3)
    assert ("right", "HMC_1") not in {name[1:] for name in detector.asked} and len(detector.asked) == 2 * (4 + 2)


@pytest.mark.parametrize(
    ("num_seen", "min_views", "reason"),
    [(0, 2, "no_detection"), (1, 2, "too_few_views"), (2, 3, "too_few_views"), (2, 2, "")],
)
def test_too_few_views_say_so(run: Run, num_seen: int, min_views: int, reason: str) -> None:
    detector = _Knowing(lambda pixels, confidence, frame, hand, place: place < num_seen)
    for row in run(_crops(), detector, min_views=min_views):
        assert set(row["reason"]) == {reason} and set(row["valid"]) == {not reason}
        assert np.isfinite(_points(row)).all() == np.isfinite(row["reprojection_px"]).all() == (not reason)
        assert set(row["num_views"]) == {0 if reason else 2}


def test_hands_without_any_crop_have_their_row(run: Run) -> None:
    rows = run(_crops(is_there=lambda frame, *_: frame == 0))
    assert [set(row["reason"]) for row in rows] == [{""}, {""}, {"no_detection"}, {"no_detection"}]
    nothing = _Knowing()
    assert len(run(_crops(is_there=lambda *_: False), nothing)) == 4 and nothing.asked == []
    assert run(EGO_CROPS.empty()) == []


def test_one_view_that_is_off_is_left_out_and_unsure_joints_are_not_used(run: Run) -> None:
    def spoil(pixels: np.ndarray, confidence: np.ndarray, frame: int, hand: str, place: int) -> bool:
        pixels[3] += (30.0, 0.0) if place == 2 else (0.0, 0.0)
        confidence[7] = 0.05 if place > 0 else 1.0  # below the least
        confidence[8] = 0.05
        return True

    for row in run(_crops(), _Knowing(spoil)):
        assert row["num_views"][3] == 3 and row["reason"][7] == "too_few_views" and row["reason"][8] == "no_detection"
        known = [place for place in range(NUM_JOINTS) if place not in (7, 8)]
        np.testing.assert_allclose(_points(row)[known], _true(row)[known], rtol=0, atol=1e-3)
        assert not np.isfinite(_points(row)[[7, 8]]).any()


def test_a_stray_is_taken_back(run: Run) -> None:
    """All views agree on a joint two metres off."""

    def spoil(pixels: np.ndarray, confidence: np.ndarray, frame: int, hand: str, place: int) -> bool:
        pixels[5] = _camera(frame, place).project(np.array([0.0, 0.0, 700.0]))
        return True

    for row in run(_crops(), _Knowing(spoil), min_parallax_rad=0.0):
        assert row["reason"][5] == "outside_hand" and sum(row["valid"]) == NUM_JOINTS - 1
        assert not row["valid"][5] and np.isnan(_points(row)[5]).all() and np.isnan(row["reprojection_px"][5])
    (wide, *_) = run(_crops(), _Knowing(spoil), min_parallax_rad=0.0, max_span_mm=500.0)
    np.testing.assert_allclose(_points(wide)[5], [0.0, 0.0, 700.0], atol=0.1)


def test_a_detector_of_raw_pictures_keypoints_is_refused(run: Run) -> None:
    detector = _Knowing()
    detector.needs_image = False
    with pytest.raises(ValueError, match="detector precomputed knows raw pictures alone, these are crops"):
        run(_crops(), detector, detector="precomputed", options={"precomputed": {"root": "nowhere"}})


def test_keypoints_that_come_with_a_recording_are_not_those_of_its_headset(tmp_path: Path) -> None:
    config = _config(detector="auto").resolved(tmp_path, "learned")
    assert config.detector == "learned"
    assert _config(detector="mediapipe").resolved(tmp_path, "learned").detector == "mediapipe"
