"""Bodies detected in small videos in which a bright square says where somebody is."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.detectors.base import BodyDetections
from assemblyhands_core.detectors.bodies import BodiesInViews, detect_bodies

WIDTH_PX, HEIGHT_PX, SIDE_PX = 160, 96, 16
Views = list[dict[str, Any]]


class Squares:
    """A detector for which every bright column of an image is a person, all keypoints in the middle of it."""

    needs_image = True

    def __init__(self) -> None:
        self.asked: list[tuple[str, int, tuple[int, ...]]] = []

    def detect(self, image_rgb: Any, camera_id: str, frame: int) -> BodyDetections:
        self.asked.append((camera_id, frame, image_rgb.shape))
        bright = image_rgb.mean(axis=2) > 128
        edges = np.flatnonzero(np.diff(np.r_[0, bright.any(axis=0).astype(int), 0]))
        persons = []
        for left, right in edges.reshape(-1, 2):
            rows = np.flatnonzero(bright[:, left:right].any(axis=1))
            persons.append(np.tile([(left + right - 1) / 2, (rows[0] + rows[-1]) / 2], (17, 1)))
        return BodyDetections(np.array(persons).reshape(-1, 17, 2), np.full((len(persons), 17), 0.8))


@pytest.fixture
def views(tmp_path: Path) -> Callable[..., Views]:
    """Return a maker of views: for each the left edges of the squares in each of its frames."""

    def make(*squares: list[list[int]]) -> Views:
        rows = []
        for name, frames in zip("ab", squares, strict=False):
            path = tmp_path / f"{name}.mp4"
            with VideoWriter(path, WIDTH_PX, HEIGHT_PX, Fraction(30), crf=5) as video:
                for lefts in frames:
                    picture = np.full((HEIGHT_PX, WIDTH_PX, 3), 20, np.uint8)
                    for left in lefts:
                        picture[32 : 32 + SIDE_PX, left : left + SIDE_PX] = 240
                    video.write(picture)
            rows.append({"camera_id": name, "video_file": str(path), "width_px": WIDTH_PX, "height_px": HEIGHT_PX})
        return rows

    return make


def _x(found: BodiesInViews, frame: int, view: int) -> list[float]:
    return found.keypoints_px[frame, view, : found.num_persons[frame, view], 0, 0].tolist()


def test_persons_are_found_frame_by_frame_and_padded_with_nothing(views: Any) -> None:
    found = detect_bodies(Squares(), views([[16], [], [32, 96]], [[64], [64], [64]]), range(3))
    assert found.num_persons.tolist() == [[1, 1], [0, 1], [2, 1]]
    assert found.keypoints_px.shape == (3, 2, 2, 17, 2) and found.confidence.shape == (3, 2, 2, 17)
    assert [_x(found, f, 0) for f in range(3)] == [[23.5], [], [39.5, 103.5]]
    assert [_x(found, f, 1) for f in range(3)] == [[71.5]] * 3
    assert found.keypoints_px[0, 0, 0].tolist() == [[23.5, 39.5]] * 17
    assert np.isnan(found.keypoints_px[0, 0, 1]).all() and not found.confidence[0, 0, 1].any()
    assert found.reason.tolist() == [["", ""], ["no_detection", ""], ["", ""]]


def test_frames_start_where_they_are_asked_for(views: Any) -> None:
    found = detect_bodies(Squares(), views([[16], [32], [48], [64]]), range(2, 4))
    assert [_x(found, f, 0) for f in range(2)] == [[55.5], [71.5]]


def test_keypoints_of_reduced_images_are_at_full_size(views: Any) -> None:
    detector = Squares()
    found = detect_bodies(detector, views([[32]]), range(1), max_image_side_px=40)
    assert detector.asked == [("a", 0, (24, 40, 3))]
    # The square spans [31.5, 47.5] × [31.5, 47.5]; a quarter of it is 4 px wide, so its middle is exact.
    assert found.keypoints_px[0, 0, 0, 0].tolist() == [39.5, 39.5]


@pytest.mark.parametrize(("num_frames", "looked_at"), [(7, [0, 3, 6]), (6, [0, 3, 5]), (1, [0])])
def test_every_nth_frame_and_the_last_are_looked_at(views: Any, num_frames: int, looked_at: list[int]) -> None:
    detector = Squares()
    found = detect_bodies(detector, views([[8 * f] for f in range(7)]), range(num_frames), every_nth_frame=3)
    assert [frame for _, frame, _ in detector.asked] == looked_at
    for frame in range(num_frames):
        assert found.reason[frame, 0] == ("" if frame in looked_at else "skipped_frame")
        assert _x(found, frame, 0) == ([8 * frame + 7.5] if frame in looked_at else [])


def test_frames_that_a_view_lacks_are_said_to_be_missing(views: Any) -> None:
    found = detect_bodies(Squares(), views([[16]] * 4, [[16]] * 2), range(4))
    assert found.reason.tolist() == [["", ""], ["", ""], ["", "missing_frame"], ["", "missing_frame"]]
    assert found.num_persons.tolist() == [[1, 1], [1, 1], [1, 0], [1, 0]]
    found = detect_bodies(Squares(), views([[16]] * 7, [[16]] * 2), range(7), every_nth_frame=4)
    assert found.reason[:, 1].tolist() == [
        "",
        *["skipped_frame"] * 3,
        "missing_frame",
        "skipped_frame",
        "missing_frame",
    ]


def test_a_detector_without_images_is_asked_without_opening_the_video() -> None:
    class Known:
        needs_image = False

        def detect(self, image_rgb: Any, camera_id: str, frame: int) -> BodyDetections:
            assert image_rgb is None
            return BodyDetections(np.full((1, 17, 2), float(frame)), np.ones((1, 17)))

    view = {"camera_id": "a", "video_file": "/absent.mp4", "width_px": 10, "height_px": 10}
    found = detect_bodies(Known(), [view], range(5, 8), every_nth_frame=2)
    assert found.reason[:, 0].tolist() == ["", "skipped_frame", ""]
    assert [_x(found, f, 0) for f in range(3)] == [[5.0], [], [7.0]]


def test_no_frames_have_no_persons() -> None:
    found = detect_bodies(Squares(), [], range(0))
    assert found.keypoints_px.shape == (0, 0, 1, 17, 2) and found.reason.shape == (0, 0)
