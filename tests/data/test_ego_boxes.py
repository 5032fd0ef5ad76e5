"""Boxes of hands in egocentric pictures, by hand: which become crops, and whose joints they show."""

import numpy as np
import pytest

from assemblyhands_core.data.ego_boxes import EgoRule, ego_box, identity_of

SIZE_PX = (636, 480)
RULE = EgoRule(gamma=2.0, min_joints=15, min_border_px=-10.0, min_other_share=0.5)
ALL = np.full(21, True)


def _joints(x_px: float, y_px: float, step_px: float = 2.0) -> np.ndarray:
    """A row of joints from (x, y) to the right."""
    return np.stack([x_px + step_px * np.arange(21), np.full(21, y_px)], axis=-1)


def test_a_box_is_twice_the_extent_around_the_middle() -> None:
    box = ego_box(_joints(100.0, 200.0), ALL, SIZE_PX, RULE)
    np.testing.assert_allclose(box.center_px, [120.0, 200.0])
    assert (box.side_px, box.num_in_image, box.border_px, box.reason) == (80.0, 21, 100.5, "")
    np.testing.assert_array_equal(box.contains(np.array([[80.0, 240.0], [79.9, 200.0], [np.nan, 0.0]])), [1, 0, 0])


@pytest.mark.parametrize(
    ("joints", "is_known", "reason", "num_in_image", "border_px"),
    [
        (_joints(100.0, 200.0), ~ALL, "unknown_hand", 0, np.nan),
        (np.where(np.arange(21)[:, None] == 4, np.nan, _joints(100.0, 200.0)), ALL, "behind_camera", 0, np.nan),
        (_joints(700.0, 200.0), ALL, "outside_view", 0, 635.5 - 740.0),
        (_joints(-20.5, 200.0), ALL, "too_few_joints", 11, -20.0),  # x = -0.5 is the border and still inside
        (_joints(-12.0, 200.0), ALL, "near_border", 15, -11.5),
        (_joints(-9.0, 200.0), ALL, "", 16, -8.5),
        (_joints(300.0, 484.0), ALL, "outside_view", 0, -4.5),
    ],
)
def test_hands_without_crop_say_why(
    joints: np.ndarray, is_known: np.ndarray, reason: str, num_in_image: int, border_px: float
) -> None:
    box = ego_box(joints, is_known, SIZE_PX, RULE)
    assert (box.reason, box.num_in_image) == (reason, num_in_image)
    np.testing.assert_allclose(box.border_px, border_px)
    assert np.isfinite(box.side_px) == (reason == "")


def test_joints_that_nobody_annotated_do_not_widen_the_box() -> None:
    joints, is_known = _joints(100.0, 200.0), np.arange(21) < 16
    joints[20] = [600.0, 10.0]
    box = ego_box(joints, is_known, SIZE_PX, RULE)
    assert box.side_px == 60.0 and box.num_in_image == 16


@pytest.mark.parametrize(("num_inside", "expected"), [(10, "left"), (11, "both"), (21, "both"), (0, "left")])
def test_a_crop_shows_both_hands_from_half_of_the_other_ones_joints_on(num_inside: int, expected: str) -> None:
    box = ego_box(_joints(100.0, 200.0), ALL, SIZE_PX, RULE)
    other = np.where(np.arange(21)[:, None] < num_inside, [120.0, 210.0], [400.0, 210.0])
    assert identity_of(box, "left", other, ALL, RULE) == expected
    assert identity_of(box, "left", other, ~ALL, RULE) == "left"
