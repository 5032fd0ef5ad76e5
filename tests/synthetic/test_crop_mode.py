"""Crops: exact cameras, one scene behind all boxes, the right hand where it is said to be, the same bytes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from assemblyhands_core.geometry.crops import crop_camera, source_pixels
from assemblyhands_core.hands.joints import HANDS, ROOT
from assemblyhands_core.synthetic.crop_boxes import AroundHand, AroundPoint, Windows
from assemblyhands_core.synthetic.crop_mode import CropStudio, HandViews
from assemblyhands_core.synthetic.figure import HAND_IDS
from assemblyhands_core.synthetic.render import Sensor, render
from assemblyhands_core.synthetic.rig import assembly_rig
from assemblyhands_core.synthetic.take import Take

SENSOR_SEED = 5
CAMERAS = ("C10095_rgb", "C10119_rgb", "C10404_rgb")
TIMES_S = (3.0, 7.5)


@pytest.fixture(scope="module")
def studio(take: Take) -> CropStudio:
    return CropStudio.of(take, assembly_rig(1), SENSOR_SEED, CAMERAS)


def sensor_noise(camera_id: str) -> float:
    return Sensor.from_seed(SENSOR_SEED, camera_id).noise


def shown(views: HandViews, view: int, margin_px: int = 0) -> np.ndarray:
    """Which joints are visible at least so far inside a crop."""
    size = views.images.shape[1]
    inside = (views.joints_px[view] > margin_px) & (views.joints_px[view] < size - 1 - margin_px)
    return np.asarray(views.is_visible[view] & inside.all(axis=-1))


def at_joints(views: HandViews, view: int, joints: np.ndarray) -> np.ndarray:
    x, y = np.rint(views.joints_px[view][joints]).astype(int).T
    return np.asarray(views.object_id[view, y, x])


def test_crops_are_rgb_with_the_exact_camera_of_the_rectified_view(studio: CropStudio) -> None:
    instant = studio.at(TIMES_S[0])
    views = instant.hand_views("right", 96, AroundHand(1.5))
    assert views.images.shape == (3, 96, 96, 3) and views.object_id.shape == (3, 96, 96)
    assert views.is_valid.all() and views.is_in_crop.all()
    assert tuple(camera.camera_id for camera in views.cameras) == CAMERAS
    assert_array_equal(views.joints_world_mm, instant.state.joints_world_mm[:21])
    for camera, whole, source, joints_px in zip(
        views.cameras, instant.rectified, instant.sources, views.joints_px, strict=True
    ):
        extent = np.ptp(whole.project(views.joints_world_mm), axis=0).max()
        assert camera.fx_px / whole.fx_px == pytest.approx(96 / (1.5 * extent))
        assert_allclose(joints_px, camera.project(views.joints_world_mm))
        # The longer side of the hand fills 1/γ of the crop, in its middle.
        assert np.ptp(joints_px, axis=0).max() == pytest.approx(96 / 1.5)
        assert_allclose((joints_px.min(axis=0) + joints_px.max(axis=0)) / 2, 47.5)
        raw = source.project(views.joints_world_mm)
        assert_allclose(source_pixels(source, camera, joints_px), raw, atol=1e-6)


def test_a_shifted_window_shows_the_same_pixels_but_for_noise(studio: CropStudio) -> None:
    instant = studio.at(TIMES_S[0])
    root = instant.state.joints_world_mm[ROOT]
    centers = np.stack([camera.project(root) for camera in instant.rectified])
    sides = np.full(len(centers), 256.0)  # two pixels of the picture make one of the crop
    one = instant.hand_views("right", 128, Windows(centers, sides))
    other = instant.hand_views("right", 128, Windows(centers + np.array([32.0, -16.0]), sides))
    for view, camera_id in enumerate(CAMERAS):
        overlap, moved = one.object_id[view, :120, 16:], other.object_id[view, 8:, :112]
        assert (overlap == moved).mean() > 0.9999  # rays differ by rounding
        difference = one.images[view, 2:118, 18:126].astype(float) - other.images[view, 10:126, 2:110]
        expected = np.sqrt(2) * sensor_noise(camera_id)
        assert abs(np.median(difference)) <= 1.0
        assert 0.8 * expected < 1.4826 * np.median(np.abs(difference)) < 1.5 * expected + 0.5


def test_another_box_shows_the_same_scene_through_both_cameras(studio: CropStudio) -> None:
    instant = studio.at(TIMES_S[1])
    root = instant.state.joints_world_mm[ROOT]
    near = instant.hand_views("right", 160, AroundPoint(root, 110.0))
    far = instant.hand_views("right", 128, AroundPoint(root + np.array([25.0, -15.0, 20.0]), 140.0))
    for view, camera_id in enumerate(CAMERAS):
        y, x = np.mgrid[:160, :160]
        there = np.rint(source_pixels(far.cameras[view], near.cameras[view], np.stack([x, y], -1).astype(float)))
        is_shared = far.cameras[view].contains(there)
        assert is_shared.mean() > 0.8
        column, row = there[is_shared].astype(int).T
        is_same = near.object_id[view][is_shared] == far.object_id[view, row, column]
        assert is_same.mean() > 0.95  # the nearest pixel of a coarser crop errs at outlines only
        difference = near.images[view][is_shared].astype(float) - far.images[view, row, column]
        assert abs(np.median(difference)) <= 1.0
        assert np.median(np.abs(difference[is_same])) < 2.0 * sensor_noise(camera_id)
        astray = near.images[view][is_shared].astype(float) - np.roll(far.images[view], 6, axis=1)[row, column]
        assert np.abs(astray).mean() > 2.0 * np.abs(difference).mean()  # six pixels off would be noticed


def test_crops_show_what_full_pictures_show(studio: CropStudio, take: Take) -> None:
    instant = studio.at(TIMES_S[0])
    views = instant.hand_views("left", 128, AroundHand(1.4))
    source, crop = instant.sources[1], views.cameras[1]
    full = render(instant.scene, source, sensor=instant.sensors[1], frame_seed=0)
    y, x = np.mgrid[:128, :128]
    column, row = np.rint(source_pixels(source, crop, np.stack([x, y], -1).astype(float))).astype(int).reshape(-1, 2).T
    ids = full.object_id[row, column].reshape(128, 128)
    assert (ids == views.object_id[1]).mean() > 0.96
    difference = full.image[row, column].reshape(128, 128, 3).astype(float) - views.images[1]
    assert abs(np.median(difference)) <= 1.0
    assert np.median(np.abs(difference)) < 3.0 * sensor_noise(CAMERAS[1])


@pytest.mark.parametrize("t_s", TIMES_S)
def test_visible_joints_lie_on_pixels_of_their_own_hand(studio: CropStudio, t_s: float) -> None:
    for hand in HANDS:
        views = studio.hand_views(t_s, hand)
        found = np.concatenate([at_joints(views, view, shown(views, view)) for view in range(len(CAMERAS))])
        assert len(found) > 10
        assert np.mean(found == HAND_IDS[hand]) > 0.95
        hidden = views.is_in_crop & ~views.is_visible
        assert views.occlusion_rate == pytest.approx(1.0 - views.is_visible.mean())
        assert 0.0 < hidden.mean() < 0.9


def test_the_same_seed_gives_the_same_bytes_whatever_was_drawn_before(studio: CropStudio, take: Take) -> None:
    box = AroundHand(1.6, gamma_spread=0.2, center_spread=0.1)
    first = studio.hand_views(TIMES_S[0], "left", 96, box, seed=4)
    studio.hand_views(TIMES_S[1], "right", 64, box)
    again = studio.hand_views(TIMES_S[0], "left", 96, box, seed=4)
    anew = CropStudio.of(take, assembly_rig(1), SENSOR_SEED, CAMERAS).hand_views(TIMES_S[0], "left", 96, box, seed=4)
    for same in (again, anew):
        assert same.images.tobytes() == first.images.tobytes() and same.object_id.tobytes() == first.object_id.tobytes()
        assert all(a.P_pixel_from_world.tobytes() == b.P_pixel_from_world.tobytes() for a, b in
                   zip(same.cameras, first.cameras, strict=True))  # fmt: skip
    other = studio.hand_views(TIMES_S[0], "left", 96, box, seed=5)
    assert other.cameras[0].cx_px != first.cameras[0].cx_px


def test_both_hands_and_all_boxes_share_the_scene_of_an_instant(studio: CropStudio) -> None:
    instant = studio.at(TIMES_S[0])
    meshes = instant.scene.moving_surfaces
    studio.hand_views(TIMES_S[0], "right", 32)
    studio.hand_views(TIMES_S[0], "left", 32, AroundHand(2.0))
    assert studio.at(TIMES_S[0]) is instant and instant.scene.moving_surfaces is meshes
    assert studio.at(TIMES_S[1]).scene.static is instant.scene.static


def test_views_without_the_hand_are_not_valid_and_black(take: Take) -> None:
    rig = assembly_rig(1)
    studio = CropStudio.of(take, rig, SENSOR_SEED, tuple(rig.ego))
    views = studio.hand_views(TIMES_S[0], "right", 64)
    is_in_picture = np.array(
        [c.contains(c.project(views.joints_world_mm)).any() for c in studio.at(TIMES_S[0]).sources]
    )
    assert 0 < is_in_picture.sum() < 4  # two cameras look down at the hands, two to the sides
    assert_array_equal(views.is_valid, is_in_picture)
    assert not views.images[~views.is_valid].any() and not views.is_in_crop[~views.is_valid].any()
    assert not views.is_visible[~views.is_valid].any()
    shown_views = views.images[views.is_valid]
    assert shown_views.std() > 5.0 and (shown_views == shown_views[..., :1]).all()  # grey


def test_a_crop_is_black_beyond_the_raw_picture(studio: CropStudio) -> None:
    instant = studio.at(TIMES_S[0])
    source = instant.sources[0]
    centers = np.tile([0.0, 500.0], (len(CAMERAS), 1))  # about half of the window lies left of the picture
    views = instant.hand_views("right", 64, Windows(centers, np.full(len(CAMERAS), 200.0)))
    crop = crop_camera(instant.rectified[0], centers[0], 200.0, 64)
    y, x = np.mgrid[:64, :64]
    is_there = source.contains(source_pixels(source, crop, np.stack([x, y], -1).astype(float)))
    assert 0.3 < is_there.mean() < 0.75
    assert not views.images[0][~is_there].any() and views.images[0][is_there].any(axis=-1).mean() > 0.99


def test_a_window_that_shows_nothing_of_the_picture_is_not_valid(studio: CropStudio) -> None:
    centers = np.array([[960.0, 540.0], [-5000.0, 500.0], [np.nan, np.nan]])
    views = studio.at(TIMES_S[0]).hand_views("right", 64, Windows(centers, np.array([300.0, 300.0, np.nan])))
    assert views.is_valid.tolist() == [True, False, False]
    assert views.images[0].any() and not views.images[1:].any() and not views.is_in_crop[1:].any()
    assert views.is_visible[1:].any()  # the hand is in these pictures nevertheless


def test_oblique_crops_of_the_headset_show_the_hand_too(take: Take) -> None:
    rig = assembly_rig(1)
    studio = CropStudio.of(take, rig, SENSOR_SEED, list(rig.ego)[:2])
    found = []
    for t_s in np.arange(0.5, 14.0, 1.5).tolist():
        for hand in HANDS:
            views = studio.hand_views(t_s, hand, 64)
            found += [at_joints(views, view, shown(views, view)) == HAND_IDS[hand] for view in (0, 1)]
    assert len(np.concatenate(found)) > 20
    assert np.concatenate(found).mean() > 0.95


def test_unknown_cameras_are_refused(take: Take) -> None:
    with pytest.raises(ValueError, match="The assembly rig has no camera D01_rgb"):
        CropStudio.of(take, assembly_rig(1), SENSOR_SEED, ("D01_rgb",))
