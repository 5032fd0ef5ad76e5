import numpy as np
import pytest

from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES
from assemblyhands_core.viz.overlays import (
    FINGER_COLORS,
    HAND_COLORS,
    contact_sheet,
    draw_body,
    draw_box,
    draw_hand,
    line_width_px,
)

GRAY = np.full((200, 300, 3), 90, dtype=np.uint8)


def hand(places: dict[int, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    keypoints = np.full((21, 2), np.nan)
    for joint, place in places.items():
        keypoints[joint] = place
    return keypoints, np.isfinite(keypoints).all(axis=1)


def changed(picture: np.ndarray) -> np.ndarray:
    return (picture != 90).any(axis=-1)


def test_a_bone_is_drawn_where_it_lies_in_its_fingers_colour_and_nowhere_else() -> None:
    # Index base (7) to wrist (20), along row 100 from x = 50 to x = 250.
    picture = draw_hand(GRAY, *hand({7: (50.0, 100.0), 20: (250.0, 100.0)}), "right")
    assert tuple(picture[100, 150]) == FINGER_COLORS[1]
    assert tuple(picture[100, 50]) == FINGER_COLORS[1] and tuple(picture[100, 250]) == (255, 255, 255)
    drawn = changed(picture)
    assert drawn[100, 50:251].all()
    # The line and its rim are 4 px wide, the discs at its ends 8 px, both soft by a pixel.
    assert not drawn[:95].any() and not drawn[106:].any() and not drawn[:, :45].any() and not drawn[:, 256:].any()
    assert not drawn[96, 60:240].any() and not drawn[104, 60:240].any()
    assert (GRAY == 90).all()


def test_each_finger_has_its_own_colour() -> None:
    for finger in range(5):
        places = {4 * finger: (20.0, 50.0), 4 * finger + 1: (80.0, 50.0)}
        assert tuple(draw_hand(GRAY, *hand(places), "right")[50, 50]) == FINGER_COLORS[finger]
    assert len(set(FINGER_COLORS)) == 5


def test_a_left_bone_is_dashed_and_a_right_one_is_not() -> None:
    # 210 px in 7 parts of 30: drawn from 40 to 70, 100 to 130 and so on.
    places = hand({7: (40.0, 100.0), 20: (250.0, 100.0)})
    left, right = changed(draw_hand(GRAY, *places, "left"))[100], changed(draw_hand(GRAY, *places, "right"))[100]
    for middle in (55, 115, 175, 235):
        assert left[middle] and right[middle]
    for gap in (85, 145, 205):
        assert not left[gap - 8 : gap + 9].any() and right[gap - 8 : gap + 9].all()


def test_invalid_and_infinite_joints_and_their_bones_are_left_out() -> None:
    keypoints, valid = hand({7: (50.0, 100.0), 20: (250.0, 100.0), 6: (50.0, 20.0)})
    valid[20] = False
    keypoints[5], valid[5] = (np.inf, 3.0), True
    drawn = changed(draw_hand(GRAY, keypoints, valid, "right"))
    assert not drawn[100, 60:].any() and drawn[20:101, 50].all()
    nothing = draw_hand(GRAY, keypoints, np.zeros(21, dtype=np.bool_), "right")
    np.testing.assert_array_equal(nothing, GRAY)


def test_joints_far_outside_the_picture_do_no_harm() -> None:
    picture = draw_hand(GRAY, *hand({7: (1e9, 100.0), 20: (150.0, 100.0)}), "right")
    drawn = changed(picture)
    assert drawn[100, 150:].all() and not drawn[100, :140].any()


def test_a_body_shows_its_sides() -> None:
    keypoints = np.full((17, 2), np.nan)
    for name, place in {
        "right_elbow": (20.0, 50.0),
        "right_wrist": (160.0, 50.0),
        "left_elbow": (20.0, 150.0),
        "left_wrist": (160.0, 150.0),
    }.items():
        keypoints[BODY_KEYPOINT_NAMES.index(name)] = place
    picture = draw_body(GRAY, keypoints, np.isfinite(keypoints).all(axis=1))
    assert tuple(picture[50, 50]) == HAND_COLORS["right"] and changed(picture)[50, 20:160].all()
    assert tuple(picture[150, 30]) == HAND_COLORS["left"] and not changed(picture)[150, 45:55].any()  # second of 7
    assert not changed(picture)[70:130].any()


def test_a_box_is_an_outline() -> None:
    corners = np.array([[50.0, 40.0], [150.0, 40.0], [150.0, 140.0], [50.0, 140.0]])
    picture = draw_box(GRAY, corners, "right")
    assert all(tuple(picture[y, x]) == HAND_COLORS["right"] for y, x in ((40, 100), (90, 150), (140, 100), (90, 50)))
    assert not changed(picture)[45:136, 55:146].any()
    np.testing.assert_array_equal(draw_box(GRAY, np.full((4, 2), np.nan)), GRAY)


def test_lines_grow_with_the_picture() -> None:
    assert [line_width_px(np.zeros((h, w, 3), np.uint8)) for h, w in ((100, 90), (1920, 1000), (1000, 4000))] == [
        2,
        4,
        4,
    ]


def test_a_contact_sheet_places_tiles_row_by_row_under_their_captions() -> None:
    tiles = [np.full((40, 60, 3), value, dtype=np.uint8) for value in (50, 100, 150)]
    sheet = contact_sheet(tiles, columns=2, captions=["a", "b", "c"])
    # A caption is 16 px high: rows of 56 px, columns of 60.
    assert sheet.shape == (112, 120, 3)
    assert (sheet[16:56, :60] == 50).all() and (sheet[16:56, 60:] == 100).all()
    assert (sheet[72:, :60] == 150).all() and (sheet[56:, 60:] == 0).all()
    assert all(sheet[top : top + 16, left : left + 60].max() > 200 for top, left in ((0, 0), (0, 60), (56, 0)))


def test_tiles_of_another_shape_are_fitted_and_keep_it() -> None:
    wide, small = np.full((40, 80, 3), 100, dtype=np.uint8), np.full((20, 20, 3), 200, dtype=np.uint8)
    sheet = contact_sheet([wide, small], columns=1, captions=["", ""])
    assert sheet.shape == (112, 80, 3)
    assert (sheet[72:, 20:60] == 200).all() and (sheet[72:, :20] == 0).all() and (sheet[72:, 60:] == 0).all()


def test_a_long_caption_stays_on_its_own_tile() -> None:
    tiles = [np.zeros((40, 60, 3), dtype=np.uint8)] * 2
    sheet = contact_sheet(tiles, columns=2, captions=["a very long caption of a picture indeed", ""])
    assert sheet[:16, :60].max() > 100 and (sheet[:16, 60:] == 0).all()


def test_captions_may_have_lines_and_all_tiles_get_the_room() -> None:
    tiles = [np.full((40, 60, 3), 50, dtype=np.uint8)] * 2
    sheet = contact_sheet(tiles, columns=2, captions=["a\nb", "a"])
    assert sheet.shape == (72, 120, 3)  # two lines of 16 px
    assert np.array_equal(sheet[:16, :60], sheet[:16, 60:]) and sheet[16:32, :60].max() > 200
    assert (sheet[16:32, 60:] == 0).all() and (sheet[32:] == 50).all()


@pytest.mark.parametrize(("tiles", "columns", "captions"), [(0, 2, 0), (1, 0, 1), (2, 1, 1)])
def test_a_sheet_that_cannot_be_made_is_refused(tiles: int, columns: int, captions: int) -> None:
    with pytest.raises(ValueError, match=f"{tiles} tiles, {captions} captions and {columns} columns"):
        contact_sheet([GRAY] * tiles, columns, ["x"] * captions)


def test_drawing_twice_gives_the_same_picture() -> None:
    places = hand({j: (10.0 + 11.3 * j, 20.0 + 7.7 * j) for j in range(21)})
    np.testing.assert_array_equal(draw_hand(GRAY, *places, "left"), draw_hand(GRAY, *places, "left"))
