"""Crops by round, by what stands at known places of the sheet."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.hand_crops import StoredHand, StoredView
from assemblyhands_core.data.rounds import Box, KnownHand, WindowRule
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.viz.overlays import FINGER_COLORS
from assemblyhands_core.viz.round_sheet import (
    HandCourse,
    HandRound,
    Look,
    choose_hands,
    draw_sheet,
    follow_hand,
    save_sheet,
)

RULE = WindowRule(gamma=1.5, min_joints=11, min_inside=0.5)
KEY = ("monday", 7, "right")
YELLOW = (240, 228, 66)
NOWHERE_PX = np.full((21, 2), np.nan)
TILE_PX = 212  # of which the crop of 200 px takes 200
CAPTION_PX = 19  # of a tile: 9 % of its side
TITLE_PX = 21  # of a row: 9 % of tile and caption
LEFT_PX, TOP_PX = 6, TITLE_PX + CAPTION_PX + 6  # where the crop of the first tile begins


def _view(camera_id: str = "front", shade: int = 90) -> StoredView:
    """A grey crop of 200 px, 1 px a mm, of a camera 1 m before the world's origin."""
    P = np.array([[1000.0, 0, 99.5, 99.5e3], [0, 1000.0, 99.5, 99.5e3], [0, 0, 1, 1000.0]])
    return StoredView(camera_id, encode_jpeg(np.full((200, 200, 3), shade, np.uint8), 95), P, (200, 200))


def _round(
    number: int, joints_mm: np.ndarray, kept_round: int | None = None, reason: str = "", box: Box | None = None
) -> HandRound:
    known = KnownHand(KEY, number, joints_mm, np.full(3, np.nan), {} if box is None else {"front": box})  # type: ignore[arg-type]
    return HandRound(known, number if kept_round is None else kept_round, reason)


def _square(side_mm: float, x_mm: float = 0.0) -> np.ndarray:
    """21 joints on the corners of an upright square around (x, 0, 0)."""
    corners = side_mm / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return np.asarray(corners[np.arange(21) % 4] + (x_mm, 0, 0))


def _follow(rounds: list[HandRound], *views: StoredView) -> HandCourse:
    stored = StoredHand(KEY, views or (_view(),))  # type: ignore[arg-type]
    return follow_hand(rounds, stored, {"front": _view().P_pixel_from_world}, RULE)


def test_the_hand_that_moved_farthest_of_each_stretch_is_chosen() -> None:
    hands: tuple[Hand, Hand] = ("right", "left")
    keys: list[tuple[str, int, Hand]] = [("s", frame, hand) for frame in range(8) for hand in hands]
    moved_mm = np.arange(16.0)
    assert choose_hands(keys, moved_mm, 4) == [3, 7, 11, 15], "two instants of two hands a stretch"
    assert choose_hands(keys, -moved_mm, 4) == [0, 4, 8, 12]
    assert choose_hands(keys, moved_mm, 1) == [15]
    # In any order, here backwards; by time all the same.
    assert choose_hands(keys[::-1], moved_mm[::-1], 4) == [12, 8, 4, 0]


def test_hands_that_nothing_is_known_of_are_not_chosen() -> None:
    keys: list[tuple[str, int, Hand]] = [("s", frame, "left") for frame in range(4)]
    assert choose_hands(keys, np.array([1.0, np.nan, np.nan, 2.0]), 4) == [0, 3]
    assert choose_hands(keys, np.array([1.0, np.nan, np.nan, 2.0]), 2) == [0, 3]
    assert choose_hands(keys[:1], np.array([5.0]), 4) == [0]
    assert choose_hands([], np.empty(0), 4) == []
    two: list[tuple[str, int, Hand]] = [("b", 0, "left"), ("a", 9, "left")]
    assert choose_hands(two, np.array([1.0, 2.0]), 2) == [1, 0], "sequences one after the other"


def test_each_round_looks_through_the_box_of_the_round_before() -> None:
    box = Box(np.array([99.5, 89.5]), 160.0)
    course = _follow([_round(0, _square(60), box=box), _round(1, _square(40, 10.0)), _round(2, _square(36, 8.0))])
    first, second, third = course.looks
    assert first.box is None and second.box is not None and third.box is not None
    # Round 1: the detected box. Round 2: 1.5 times the 40 px around round 1's joints, whose middle is at 99.5 + 10.
    np.testing.assert_allclose(second.box.center_px, (99.5, 89.5), atol=1e-6)
    np.testing.assert_allclose(third.box.center_px, (109.5, 99.5), atol=1e-6)
    assert (second.box.side_px, third.box.side_px) == (pytest.approx(160.0), pytest.approx(60.0))
    np.testing.assert_allclose(first.joints_px[0], (69.5, 69.5), atol=1e-6)
    np.testing.assert_allclose(third.joints_px[2], (99.5 + 8 + 18, 99.5 + 18), atol=1e-6)


def test_captions_say_what_became_of_the_hand() -> None:
    shifted = _square(40, 3.0)
    some = np.where((np.arange(21) < 5)[:, None], shifted, np.nan)
    rounds = [
        _round(0, _square(40)),
        _round(1, shifted),
        _round(2, shifted, kept_round=1, reason="high_reprojection"),
        _round(3, some),
        _round(4, np.full((21, 3), np.nan), reason="too_few_views"),
        _round(5, shifted),
    ]
    assert [look.caption for look in _follow(rounds).looks] == [
        "2D + triangulation",
        "R1: moved 3.0 mm",
        "R2 keeps R1: high reprojection",
        "R3: moved 0.0 mm, 5 joints",
        "R4: too few views",
        "R5",
    ]
    kept = [_round(0, shifted), _round(1, shifted, kept_round=0, reason="jumped")]
    assert _follow(kept).looks[1].caption == "R1 keeps 2D + triangulation: jumped"


@pytest.mark.parametrize(
    ("reason", "looked"), [("", True), ("jumped", True), ("converged", False), ("too_few_views", False)]
)
def test_a_round_that_did_not_ask_the_network_has_no_window(reason: str, looked: bool) -> None:
    course = _follow([_round(0, _square(40)), _round(1, _square(40)), _round(2, _square(40), reason=reason)])
    assert (course.looks[2].box is not None) == looked
    assert course.looks[1].box is None, "no box was detected"


def test_the_view_shows_most_joints_and_of_such_views_most_motion() -> None:
    last = _square(40, 70.0)
    # The second view sees along x: it shows no motion. The third looks closer, and loses half of the joints.
    along = _view("along")
    P_along = along.P_pixel_from_world[:, [2, 1, 0, 3]]
    close = StoredView("close", along.image, np.diag([1.6, 1.6, 1.0]) @ along.P_pixel_from_world, (200, 200))
    still = StoredView("along", along.image, P_along, (200, 200))
    rounds = [_round(0, _square(40)), _round(1, last)]
    for views in ((still, _view(), close), (close, _view(), still)):
        assert _follow(rounds, *views).view.camera_id == "front"
    assert _follow(rounds, close, still).view.camera_id == "along"


def _course(looks: tuple[Look, ...], hand: Hand = "right", shade: int = 90) -> HandCourse:
    return HandCourse(("monday", 7, hand), _view(shade=shade), looks)


def _joints_px(**places: tuple[float, float]) -> np.ndarray:
    pixels = NOWHERE_PX.copy()
    for name, place in places.items():
        pixels[int(name[1:])] = place
    return pixels


def test_windows_and_joints_stand_at_their_places() -> None:
    window = Look("R1", Box(np.array([99.5, 79.5]), 100.0), _joints_px(j7=(40, 150), j6=(160, 150), j20=(40, 20)))
    sheet = draw_sheet([_course((Look("2D + triangulation", None, NOWHERE_PX), window))], "synthetic recordings", 212)
    assert sheet.shape == (TITLE_PX + CAPTION_PX + TILE_PX, 3 * TILE_PX, 3)

    def at(column: int, x: float, y: float) -> tuple[int, ...]:
        pixel = sheet[round(TOP_PX + y), round(column * TILE_PX + LEFT_PX + x)]
        return tuple(int(value) for value in pixel)

    # The stored crop as it is, and without a window or joints.
    for column in (0, 1):
        tile = sheet[TOP_PX : TOP_PX + 200, column * TILE_PX + LEFT_PX :][:, :200]
        assert np.abs(tile[3:-3, 3:-3].astype(int) - 90).max() <= 1
    assert at(0, -4, 100) == (0, 0, 0) and at(0, 203, 100) == (0, 0, 0)
    # The window from x 49.5 to 149.5 and y 29.5 to 129.5, and nothing between its sides.
    for x, y in ((49.5, 80), (149.5, 80), (100, 29.5), (100, 129.5)):
        assert at(2, x, y) == YELLOW
    assert at(2, 100, 80) == at(2, 100, 140) == at(2, 20, 80) == (90, 90, 90)
    # The bone of the index finger, its joints, and the wrist, white.
    assert at(2, 100, 150) == at(2, 40, 150) == at(2, 160, 150) == FINGER_COLORS[1]
    assert at(2, 40, 20) == (255, 255, 255) and at(2, 40, 85) == FINGER_COLORS[1]


def test_left_bones_are_dashed_and_right_ones_are_not() -> None:
    look = Look("R1", None, _joints_px(j7=(20, 100), j6=(160, 100)))
    rows = {}
    for hand in ("right", "left"):
        sheet = draw_sheet([_course((look,), hand)], "x", TILE_PX)  # type: ignore[arg-type]
        rows[hand] = (sheet[TOP_PX + 100, TILE_PX + LEFT_PX :] != 90).any(axis=-1)[:200]
    # 140 px in 7 parts of 20: the second one, from 40 to 60, is left out.
    assert rows["right"][20:160].all() and not rows["left"][45:56].any() and rows["left"][65:76].all()


def test_rows_stand_below_one_another_under_their_titles() -> None:
    looks = (Look("R1", None, NOWHERE_PX),)
    sheet = draw_sheet([_course(looks, shade=60), _course(looks, shade=200)], "synthetic recordings", TILE_PX)
    height = TITLE_PX + CAPTION_PX + TILE_PX
    assert sheet.shape == (2 * height, 2 * TILE_PX, 3)
    for row, shade in enumerate((60, 200)):
        middle = sheet[row * height + TOP_PX + 100, LEFT_PX + 100]
        assert np.abs(middle.astype(int) - shade).max() <= 1
        assert sheet[row * height : row * height + TITLE_PX].max() > 200, "the title"


def test_the_title_says_of_what_recordings_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[Any] = []

    def remember(tiles: Any, columns: int, captions: Any) -> Any:
        said.append(list(captions))
        return tiles[0]

    monkeypatch.setattr("assemblyhands_core.viz.round_sheet.contact_sheet", remember)
    draw_sheet([_course((Look("R1: moved 3.0 mm", None, NOWHERE_PX),))], "synthetic recordings")
    assert said == [
        ["stored crop", "R1: moved 3.0 mm"],
        ["synthetic recordings: monday, frame 7, right hand, front"],
    ]


def test_a_saved_sheet_has_its_colours(tmp_path: Path) -> None:
    sheet = np.zeros((4, 5, 3), np.uint8)
    sheet[1, 2] = (213, 94, 0)
    save_sheet(sheet, tmp_path / "sheet.png")
    image: Any = cv2.imread(str(tmp_path / "sheet.png"))
    np.testing.assert_array_equal(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), sheet)


def test_a_sheet_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="0 tiles"):
        draw_sheet([], "x")
