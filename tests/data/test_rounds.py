"""Windows of a round: boxes in pixels of stored crops, and what lies on them."""

import numpy as np
import pytest

from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.hand_crops import StoredHand, StoredView
from assemblyhands_core.data.rounds import Box, KnownHand, WindowRule, hand_windows, inside_share
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.geometry.distortion import Pinhole

RULE = WindowRule(gamma=1.5, min_joints=11, min_inside=0.5)
KEY = ("s", 3, "right")
WHOLE = Camera("a", 640, 480, 500.0, 480.0, 300.0, 250.0, Pinhole(), np.eye(4))
CROP = crop_camera(WHOLE, (200.0, 150.0), 120.0, 60)
VIEW = StoredView("a", encode_jpeg(np.zeros((60, 60, 3), np.uint8), 90), CROP.P_pixel_from_world, (60, 60))
NOWHERE = np.full(3, np.nan)


def _known(round: int, joints: np.ndarray | None = None, box: Box | None = None) -> KnownHand:
    points = np.full((21, 3), np.nan) if joints is None else joints
    return KnownHand(KEY, round, points, np.array([1.0, 2.0, 900.0]), {} if box is None else {"a": box})


def _behind(pixels: list[tuple[float, float]]) -> np.ndarray:
    """21 points 1 m before the camera that the rectified view shows at these pixels, in turn."""
    rays = np.array([((u - 300.0) / 500.0, (v - 250.0) / 480.0, 1.0) for u, v in pixels])
    return 1000.0 * rays[np.arange(21) % len(rays)]


def test_a_detected_box_in_pixels_of_the_crop_by_hand() -> None:
    """The crop shows x from 140 to 260 in 60 pixels: half the scale, pixel 200 at 29.5."""
    known = _known(0, box=Box(np.array([210.0, 144.0]), 80.0))
    found = hand_windows(known, StoredHand(KEY, (VIEW,)), {"a": WHOLE.P_pixel_from_world}, RULE)
    np.testing.assert_allclose(found.boxes[0].center_px, (34.5, 26.5), atol=1e-9)
    assert found.boxes[0].side_px == pytest.approx(40.0) and not found.is_crop_outside
    assert (found.box_source, found.views, found.is_left) == ("detected", (VIEW,), False)
    np.testing.assert_array_equal(found.root_world_mm, (1.0, 2.0, 900.0))


def test_a_box_around_joints_by_hand() -> None:
    joints = _behind([(190.0, 140.0), (220.0, 160.0)])
    found = hand_windows(_known(1, joints), StoredHand(KEY, (VIEW,)), {}, RULE)
    np.testing.assert_allclose(found.boxes[0].center_px, (32.0, 29.5), atol=1e-9)
    assert found.boxes[0].side_px == pytest.approx(1.5 * 15.0) and found.box_source == "joints"
    np.testing.assert_array_equal(found.root_world_mm, joints[11])
    (piece,) = found.cuts(48)
    x, y, depth = piece.P_pixel_from_world @ np.append(joints[0], 1.0)
    assert (x / depth, y / depth) == pytest.approx((23.5 - 16.0, 23.5 - 32.0 / 3))


def test_without_box_or_camera_or_crop_there_is_no_window() -> None:
    stored, box = StoredHand(KEY, (VIEW,)), Box(np.array([210.0, 144.0]), 80.0)
    assert hand_windows(_known(0), stored, {"a": WHOLE.P_pixel_from_world}, RULE).views == ()
    assert hand_windows(_known(0, box=box), stored, {}, RULE).views == ()
    assert hand_windows(_known(0, box=box), None, {"a": WHOLE.P_pixel_from_world}, RULE).views == ()
    behind = -_behind([(190.0, 140.0), (220.0, 160.0)])
    assert hand_windows(_known(1, behind), stored, {}, RULE).views == ()


def test_how_many_joints_make_a_box() -> None:
    joints, box = _behind([(190.0, 140.0), (220.0, 160.0)]), Box(np.array([210.0, 144.0]), 80.0)
    for num_known, source in ((11, "joints"), (10, "detected")):
        some = np.where((np.arange(21) < num_known)[:, None], joints, np.nan)
        stored = StoredHand(KEY, (VIEW,))
        found = hand_windows(_known(1, some, box), stored, {"a": WHOLE.P_pixel_from_world}, RULE)
        assert found.box_source == source and len(found.views) == 1


@pytest.mark.parametrize(
    ("center_px", "share"),
    [((49.5, 29.5), 1.0), ((50.5, 29.5), 0.95), ((59.5, 29.5), 0.5), ((59.5, 59.5), 0.25), ((90.0, 29.5), 0.0)],
)
def test_the_share_of_a_box_on_a_picture(center_px: tuple[float, float], share: float) -> None:
    assert inside_share(Box(np.array(center_px), 20.0), (60, 60)) == pytest.approx(share)


def test_windows_that_show_too_little_of_the_crop_are_left_out() -> None:
    for right_px, num_views in ((259.0, 1), (261.0, 0)):  # the crop ends at 260
        known = _known(0, box=Box(np.array([right_px, 150.0]), 40.0))
        found = hand_windows(known, StoredHand(KEY, (VIEW,)), {"a": WHOLE.P_pixel_from_world}, RULE)
        assert len(found.views) == num_views and found.is_crop_outside
