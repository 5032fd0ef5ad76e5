"""Pictures over small grey videos: what is drawn lies where the joints are, and every view keeps its place."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.catalog import BODY_KEYPOINTS, JOINTS, VIEWS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.video import VideoReader, VideoWriter
from stages._contract import Context
from stages.draw_overlays import STAGE, DrawOverlaysConfig

NUM_FRAMES, GREY = 5, 90
CONFIG = DrawOverlaysConfig(
    num_instants=2, tile_side_px=320, hand_tile_px=96, hand_gamma=2.0, film=True, max_film_frames=900
)
INSTANTS = (1, 3)  # two of five frames, spread evenly
# A hand laid flat on a grid 20 mm wide: a column for each finger, from the tip down to the base; the wrist below.
HAND_MM = np.array([*[(20.0 * (f - 2), 20.0 * (end - 2), 0.0) for f in range(5) for end in range(4)], (0.0, 60.0, 0.0)])


@pytest.fixture
def views(world: Any, tmp_path: Path) -> Callable[..., pa.Table]:
    """Return a maker of three views with videos, the last with fewer frames, and a fourth that cannot be used."""

    def make(last: int = NUM_FRAMES) -> pa.Table:
        rows = world.views({"d": "missing_video"}).to_pylist()
        for row, count in zip(rows, (NUM_FRAMES, NUM_FRAMES, last), strict=False):
            row |= {"video_file": str(tmp_path / f"{row['camera_id']}.mp4"), "num_frames": count}
            with VideoWriter(row["video_file"], 640, 480, Fraction(30), crf=10) as video:
                for _ in range(count):
                    video.write(np.full((480, 640, 3), GREY, np.uint8))
        return VIEWS.from_rows(rows)

    return make


def _joints(points_mm: np.ndarray) -> pa.Table:
    """The table of the right hand in all frames, each 21 joints; the left hand is missing."""
    rows = []
    for frame in range(NUM_FRAMES):
        for hand in ("right", "left"):
            points = points_mm if hand == "right" else np.full((21, 3), np.nan)
            valid = np.isfinite(points).all(axis=1)
            row = {"sequence_id": "s", "frame": frame, "hand": hand, "joints_world_mm": points.ravel()}
            row |= {"valid": valid, "reason": np.where(valid, "", "too_few_views"), "num_views": [3] * 21}
            rows.append(row | {"reprojection_px": [1.0] * 21, "source": "test", "round": 0})
    return JOINTS.from_rows(rows)


def _run(
    folder: Path, views: pa.Table, points_mm: np.ndarray = HAND_MM, body: pa.Table | None = None, **how: Any
) -> list[dict[str, Any]]:
    folder.mkdir()
    inputs = {"views": views, "body_keypoints": body or BODY_KEYPOINTS.empty(), "joints": _joints(points_mm)}
    tables = STAGE.run(CONFIG.model_copy(update=how), inputs, Context(folder, "s"))
    return tables["overlays"].to_pylist()


def _sheet(path: Path, columns: int) -> list[list[np.ndarray]]:
    """Return the cells of a sheet, two rows of them, each with its caption."""
    image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    return [np.split(row, columns, axis=1) for row in np.split(image, len(INSTANTS))]


def _is_colored(image: np.ndarray) -> np.ndarray:
    return np.asarray(np.ptp(image.astype(int), axis=2) > 60)


def test_every_picture_is_listed_with_its_digest(views: Any, tmp_path: Path) -> None:
    rows = _run(tmp_path / "out", views())
    assert {row["kind"]: row["overlay_file"] for row in rows} == {
        "contact_sheet": "contact_sheet.png",
        "hands": "hands.png",
        "film": "film.mp4",
    }
    for row in rows:
        assert row["sha256"] == digest_file(tmp_path / "out" / row["overlay_file"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(row["overlay_file"] for row in rows)


def test_joints_are_drawn_where_the_camera_sees_them(views: Any, world: Any, tmp_path: Path) -> None:
    _run(tmp_path / "out", views())
    for row in _sheet(tmp_path / "out" / "contact_sheet.png", 3):
        for cell, camera in zip(row, world.cameras[:3], strict=True):
            picture = cell[-240:]  # 320 × 240 below the caption
            ys, xs = np.nonzero(_is_colored(picture))
            pixels = (camera.project(HAND_MM) + 0.5) / 2 - 0.5
            np.testing.assert_allclose([xs.min(), ys.min()], pixels.min(axis=0), atol=6)
            np.testing.assert_allclose([xs.max(), ys.max()], pixels.max(axis=0), atol=6)


def test_the_body_is_drawn_where_its_keypoints_are(views: Any, tmp_path: Path) -> None:
    body_px = np.full((17, 2), np.nan)
    body_px[[5, 7, 9]] = (100, 60), (100, 300), (400, 300)  # left shoulder, elbow, wrist
    row = {"sequence_id": "s", "frame": INSTANTS[0], "camera_id": "b", "body_px": body_px.ravel()}
    row |= {"confidence": np.isfinite(body_px[:, 0]), "num_persons": 1, "valid": True, "reason": ""}
    _run(tmp_path / "out", views(), np.full((21, 3), np.nan), BODY_KEYPOINTS.from_rows([row]))
    rows = _sheet(tmp_path / "out" / "contact_sheet.png", 3)
    assert [[_is_colored(cell).any() for cell in row] for row in rows] == [[False, True, False], [False] * 3]
    ys, xs = np.nonzero(_is_colored(rows[0][1][-240:]))
    expected = [49.75 - 3, 199.75 + 3, 29.75 - 3, 149.75 + 3]  # (c + 0.5) / 2 - 0.5, and half a joint's size
    np.testing.assert_allclose([xs.min(), xs.max(), ys.min(), ys.max()], expected, atol=1.5)


def test_a_hand_is_enlarged_around_its_middle_and_a_missing_one_keeps_its_place(views: Any, tmp_path: Path) -> None:
    _run(tmp_path / "out", views())
    for row in _sheet(tmp_path / "out" / "hands.png", 6):
        for column, cell in enumerate(row):
            tile = cell[-96:]
            if column % 2:
                assert not tile.any()
            else:
                ys, xs = np.nonzero(_is_colored(tile))
                extent = max(np.ptp(xs), np.ptp(ys))
                assert abs(extent - 48) < 10  # half the tile: gamma is 2
                assert abs((ys.min() + ys.max()) / 2 - 47.5) < 6 and tile[0, 0] == pytest.approx(GREY, abs=3)


def test_a_single_joint_is_enlarged_no_more_than_the_video_bears(views: Any, tmp_path: Path) -> None:
    points = np.full((21, 3), np.nan)
    points[20] = 0.0
    _run(tmp_path / "out", views(), points)
    tile = _sheet(tmp_path / "out" / "hands.png", 6)[0][0][-96:]
    ys, xs = np.nonzero(np.abs(tile.astype(int).mean(axis=2) - GREY) > 40)
    assert [xs.mean(), ys.mean()] == pytest.approx([47.5, 47.5], abs=2) and len(xs) > 10


def test_a_view_that_lacks_frames_keeps_its_place_and_its_last_picture(views: Any, tmp_path: Path) -> None:
    _run(tmp_path / "out", views(last=2))
    rows = _sheet(tmp_path / "out" / "contact_sheet.png", 3)
    lacks = [[not cell[-200:].any() for cell in row] for row in rows]
    assert lacks == [[False, False, False], [False, False, True]]
    reader = VideoReader(tmp_path / "out" / "film.mp4")
    assert reader.num_frames == NUM_FRAMES
    for _, picture in reader.frames(0, NUM_FRAMES):
        cell = np.split(picture, 3, axis=1)[2]
        assert abs(float(np.median(cell[-200:])) - GREY) < 6


def test_without_any_joint_there_are_pictures_all_the_same(views: Any, tmp_path: Path) -> None:
    rows = _run(tmp_path / "out", views(), np.full((21, 3), np.nan), film=False)
    assert [row["kind"] for row in rows] == ["contact_sheet", "hands"]
    assert not _is_colored(_sheet(tmp_path / "out" / "contact_sheet.png", 3)[0][0]).any()


def test_the_film_has_at_most_so_many_frames(views: Any, tmp_path: Path) -> None:
    _run(tmp_path / "out", views(), max_film_frames=2)
    assert VideoReader(tmp_path / "out" / "film.mp4").num_frames == 2


def test_the_same_input_gives_the_same_bytes(views: Any, tmp_path: Path) -> None:
    table = views()
    assert _run(tmp_path / "one", table) == _run(tmp_path / "two", table)
