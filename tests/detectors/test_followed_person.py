"""One person among all that two or more views see."""

import numpy as np

from assemblyhands_core.detectors.base import BODY_MIRROR
from assemblyhands_core.detectors.bodies import BodiesInViews
from assemblyhands_core.detectors.followed_person import PersonInViews, follow_in_views
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole

NUM_FRAMES = 4


def _camera(name: str, angle_rad: float) -> Camera:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 3000], [0, 0, 0, 1.0]])
    return Camera(name, 640, 480, 500.0, 500.0, 319.5, 239.5, Pinhole(), pose)


CAMERAS = [_camera(name, angle) for name, angle in (("a", 0.0), ("b", 0.8), ("c", -1.0))]
BODY_MM = np.random.default_rng(0).uniform(-400, 400, (17, 3)) + np.zeros((NUM_FRAMES, 1, 1))
OTHER_MM = BODY_MM[:, ::-1] * 0.9 + np.array([300.0, 100.0, 900.0])


def _found(*persons_mm: np.ndarray) -> BodiesInViews:
    """Every view finds every person, in the order given."""
    keypoints_px = np.stack(
        [np.stack([camera.project(person) for person in persons_mm], axis=1) for camera in CAMERAS], axis=1
    )
    num_persons = np.full((NUM_FRAMES, len(CAMERAS)), len(persons_mm))
    return BodiesInViews(keypoints_px, np.full(keypoints_px.shape[:-1], 0.9), num_persons, _reasons(""))


def _reasons(reason: str) -> np.ndarray:
    return np.full((NUM_FRAMES, len(CAMERAS)), reason, dtype=object)


def _follow(found: BodiesInViews) -> PersonInViews:
    return follow_in_views(found, CAMERAS, max_reprojection_px=10.0, max_persons=3)


def test_the_person_of_all_views_is_returned_with_its_keypoints() -> None:
    person = _follow(_found(BODY_MM))
    for v, camera in enumerate(CAMERAS):
        np.testing.assert_array_equal(person.keypoints_px[:, v], camera.project(BODY_MM))
    assert (person.confidence == 0.9).all() and person.is_seen.all() and person.num_persons == 1
    assert person.sentence.startswith("followed the only person")


def test_a_view_whose_persons_fit_no_other_view_says_so() -> None:
    found = _found(BODY_MM, OTHER_MM)
    found.keypoints_px[1, 2] += 200.0
    found.confidence[2, 2], found.num_persons[2, 2], found.reason[2, 2] = 0.0, 0, "missing_frame"
    person = _follow(found)
    assert person.reason[:, 2].tolist() == ["", "not_associated", "missing_frame", ""]
    assert person.is_seen[:, :2].all() and person.is_seen[:, 2].tolist() == [True, False, False, True]
    assert np.isnan(person.keypoints_px[1:3, 2]).all() and not person.confidence[1:3, 2].any()
    assert person.num_persons == 2


def test_sides_that_a_view_exchanges_are_put_right() -> None:
    found = _found(BODY_MM)
    found.keypoints_px[:, 1] = found.keypoints_px[:, 1][:, :, list(BODY_MIRROR)]
    person = _follow(found)
    np.testing.assert_array_equal(person.keypoints_px[:, 1], CAMERAS[1].project(BODY_MM))


def test_nobody_keeps_the_reasons_and_is_told() -> None:
    found = _found(BODY_MM)
    nobody = BodiesInViews(
        np.full_like(found.keypoints_px, np.nan),
        np.zeros_like(found.confidence),
        np.zeros_like(found.num_persons),
        _reasons("no_detection"),
    )
    person = _follow(nobody)
    assert (person.reason == "no_detection").all() and not person.is_seen.any() and person.num_persons == 0
    assert person.sentence.startswith("followed nobody")
