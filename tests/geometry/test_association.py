import numpy as np
import pytest

from assemblyhands_core.geometry.association import (
    FollowedPerson,
    PersonAssociation,
    associate_persons,
    follow_person,
    point_looked_at,
)
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens, Pinhole
from assemblyhands_core.geometry.transforms import rigid

LENS = OpenCVLens(-0.05, 0.1, 0.0, 5e-4, -3e-4)
# Nose, then left and right shoulder, elbow, wrist, hip.
MIRROR = (0, 2, 1, 4, 3, 6, 5, 8, 7)
BODY = np.array(
    [
        (0, 0, 650),
        (200, 0, 450),
        (-200, 0, 450),
        (300, 50, 200),
        (-300, 50, 200),
        (250, 200, 0),
        (-250, 200, 0),
        (120, 0, 0),
        (-120, 0, 0),
    ],
    dtype=np.float64,
)
LIMITS = {"max_reprojection_px": 12.0, "max_persons": 3}


def camera(angle_deg: float, target: tuple[float, float, float] = (0.0, 0.0, 300.0), lens=LENS) -> Camera:
    """A camera 3 m from the target, level with it, that looks at it; z is up."""
    angle = np.deg2rad(angle_deg)
    forward = np.array([np.cos(angle), np.sin(angle), 0.0])
    right, down = np.array([np.sin(angle), -np.cos(angle), 0.0]), np.array([0.0, 0.0, -1.0])
    rotation = np.stack([right, down, forward])
    center = np.array(target) - 3000.0 * forward
    return Camera(f"c{angle_deg:g}", 1000, 1000, 900.0, 900.0, 499.5, 499.5, lens, rigid(rotation, -rotation @ center))


CAMERAS = [camera(angle) for angle in (0.0, 60.0, 130.0, 220.0)]


def observe(persons: np.ndarray, cameras: list[Camera] = CAMERAS) -> tuple[np.ndarray, np.ndarray]:
    """Project (F, P, K, 3) persons: detection n of every view is person n."""
    pixels = np.stack([view.project(persons) for view in cameras], axis=1)
    return pixels, np.ones(pixels.shape[:-1])


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    cosine, sine = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return points @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def moved(points: np.ndarray, x: float, y: float = 0.0) -> np.ndarray:
    return points + np.array([x, y, 0.0])


def test_two_persons_listed_in_any_order_are_told_apart() -> None:
    persons = np.stack([BODY, moved(turned(BODY, 40.0), 700.0, 300.0)])[None]
    pixels, confidence = observe(persons)
    pixels[:, 1], pixels[:, 3] = pixels[:, 1, ::-1].copy(), pixels[:, 3, ::-1].copy()
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS)
    assert sorted(found.person_index[0, :2].tolist()) == [[0, 1, 0, 1], [1, 0, 1, 0]]
    assert found.person_index[0, 2].tolist() == [-1] * 4
    assert found.num_views.tolist() == [[4, 4, 0]]
    first = 0 if found.person_index[0, 0, 0] == 0 else 1
    np.testing.assert_allclose(found.points_world_mm[0, 0], persons[0, first], atol=1e-3)
    np.testing.assert_allclose(found.center_world_mm[0, 0], np.median(persons[0, first], axis=0), atol=1e-3)
    assert np.isnan(found.points_world_mm[0, 2]).all() and np.isnan(found.center_world_mm[0, 2]).all()


def test_of_views_that_disagree_the_largest_consistent_set_is_taken() -> None:
    pixels, confidence = observe(BODY[None, None])
    stranger, _ = observe(moved(turned(BODY, 90.0), 500.0, -600.0)[None, None])
    pixels[:, 2] = stranger[:, 2]
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS)
    assert found.person_index[0, 0].tolist() == [0, 0, -1, 0]
    np.testing.assert_allclose(found.points_world_mm[0, 0], BODY, atol=1e-3)


def test_frames_are_independent_however_they_are_grouped() -> None:
    noise = np.random.default_rng(5)
    pixels, confidence = observe(np.stack([[turned(BODY, 7.0 * f), moved(BODY, 900.0)] for f in range(40)]))
    pixels = pixels + noise.normal(0, 2, pixels.shape)
    pixels[noise.random(confidence.shape) < 0.05] = np.nan
    whole = associate_persons(pixels, confidence, CAMERAS, **LIMITS, mirror=MIRROR)
    for start in (0, 17, 33):
        part = associate_persons(
            pixels[start : start + 7], confidence[start : start + 7], CAMERAS, **LIMITS, mirror=MIRROR
        )
        np.testing.assert_array_equal(part.person_index, whole.person_index[start : start + 7])
        np.testing.assert_array_equal(part.points_world_mm, whole.points_world_mm[start : start + 7])
    assert (whole.num_views[:, :2] >= 3).all()


def test_keypoints_without_confidence_do_not_count() -> None:
    pixels, confidence = observe(BODY[None, None])
    confidence[0, 3, 0, 4:] = 0.0  # four left: fewer than a view must agree on
    confidence[0, 2, 0, 5:] = 0.0  # five left: enough
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS)
    assert found.person_index[0, 0].tolist() == [0, 0, 0, -1]


def test_a_view_with_left_and_right_exchanged_is_noticed_and_put_right() -> None:
    pixels, confidence = observe(BODY[None, None])
    confidence = confidence * np.linspace(0.5, 1.0, 9)
    true_pixels, true_confidence = pixels.copy(), confidence.copy()
    pixels[:, 1], confidence[:, 1] = pixels[:, 1][..., MIRROR, :], confidence[:, 1][..., MIRROR]
    without = associate_persons(pixels, confidence, CAMERAS, **LIMITS)
    assert without.person_index[0, 0].tolist() == [0, -1, 0, 0] and not without.is_mirrored.any()
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS, mirror=MIRROR)
    assert found.person_index[0, 0].tolist() == [0, 0, 0, 0]
    assert found.is_mirrored[0, 0].tolist() == [False, True, False, False]
    selected_px, selected = follow_person(found, CAMERAS, mirror=MIRROR).select(pixels, confidence, MIRROR)
    np.testing.assert_array_equal(selected_px, true_pixels[:, :, 0])
    np.testing.assert_array_equal(selected, true_confidence[:, :, 0])


def test_where_half_the_views_are_exchanged_the_frames_around_decide() -> None:
    pixels, confidence = observe(np.stack([[turned(BODY, 3.0 * f)] for f in range(9)]))
    true_pixels = pixels.copy()
    for f, views in {3: [0, 1], 4: [2, 3], 5: [1, 3], 7: [0, 2, 3]}.items():
        pixels[f, views] = pixels[f, views][..., MIRROR, :]
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS, mirror=MIRROR)
    followed = follow_person(found, CAMERAS, mirror=MIRROR)
    assert {f: np.flatnonzero(m).tolist() for f, m in enumerate(followed.is_mirrored) if m.any()} == {
        3: [0, 1],
        4: [2, 3],
        5: [1, 3],
        7: [0, 2, 3],
    }
    np.testing.assert_array_equal(followed.select(pixels, confidence, MIRROR)[0], true_pixels[:, :, 0])


def test_a_person_who_turned_round_unseen_is_not_taken_for_mirrored() -> None:
    pixels, confidence = observe(np.stack([[BODY]] * 4 + [[turned(BODY, 180.0)]] * 4))
    found = associate_persons(pixels, confidence, CAMERAS, **LIMITS, mirror=MIRROR)
    assert not follow_person(found, CAMERAS, mirror=MIRROR).is_mirrored.any()


def test_too_few_views_or_persons_give_nobody() -> None:
    pixels, confidence = observe(BODY[None, None])
    alone = associate_persons(pixels[:, :1], confidence[:, :1], CAMERAS[:1], **LIMITS)
    assert (alone.person_index == -1).all() and not alone.is_mirrored.any()
    empty = associate_persons(pixels[:, :, :0], confidence[:, :, :0], CAMERAS, **LIMITS)
    assert empty.person_index.shape == (1, 3, 4) and (empty.person_index == -1).all()
    followed = follow_person(empty, CAMERAS)
    assert followed.sentence == "followed nobody: no person fits two views"
    selected_px, selected = followed.select(pixels[:, :, :0], confidence[:, :, :0])
    assert selected_px.shape == (1, 4, 9, 2) and np.isnan(selected_px).all() and (selected == 0).all()


@pytest.mark.usefixtures("unchecked_types")
def test_shapes_that_do_not_fit_are_refused() -> None:
    pixels, confidence = observe(BODY[None, None])
    with pytest.raises(ValueError, match="4 views but there are 3 cameras"):
        associate_persons(pixels, confidence, CAMERAS[:3], **LIMITS)
    with pytest.raises(ValueError, match="must be"):
        associate_persons(pixels, confidence[..., 0], CAMERAS, **LIMITS)


def test_cameras_look_at_the_point_where_their_axes_meet() -> None:
    np.testing.assert_allclose(point_looked_at(CAMERAS), [0.0, 0.0, 300.0], atol=1e-9)
    parallel = [camera(0.0, (0.0, y, 0.0), Pinhole()) for y in (0.0, 100.0)]
    np.testing.assert_allclose(point_looked_at(parallel), [-3000.0, 50.0, 0.0], atol=1e-6)


def follow(persons: np.ndarray, hidden: list[tuple[int, int, int]]) -> FollowedPerson:
    """Follow in (F, P, K, 3) persons of which some (frame, view, person) are not detected."""
    pixels, confidence = observe(persons)
    for frame, view, person in hidden:
        pixels[frame, view, person] = np.nan
    return follow_person(associate_persons(pixels, confidence, CAMERAS, **LIMITS), CAMERAS)


def walk(x: float, num_frames: int = 10) -> np.ndarray:
    """Walk along y: after 10 frames the median of the person's centre is (x, 90, 200), 100 below the target."""
    return np.stack([moved(BODY, x, 20.0 * f) for f in range(num_frames)])


def test_the_person_seen_by_most_views_is_followed() -> None:
    persons = np.stack([walk(0.0), walk(900.0)], axis=1)
    followed = follow(persons, [(f, v, 0) for f in range(10) for v in (1, 2)])
    assert (followed.person_index == 1).all()
    assert followed.sentence == (
        "followed person 1 of 2: seen in 4.0 of 4 views on average against 2.0 (the most); "
        "0.9 m from the point that the cameras look at against 0.1 m"
    )


def test_between_persons_seen_nearly_equally_the_nearer_is_followed() -> None:
    persons = np.stack([walk(900.0), walk(0.0)], axis=1)
    followed = follow(persons, [(f, 2, 1) for f in range(7)])
    assert followed.person_index[:, [0, 1, 3]].tolist() == [[1, 1, 1]] * 10
    assert followed.person_index[:, 2].tolist() == [-1] * 7 + [1] * 3
    assert followed.sentence.startswith("followed person 2 of 2: seen in 3.3 of 4 views on average against 4.0 (nearly")


def test_a_gap_does_not_break_a_track_but_a_leap_does() -> None:
    alone = walk(0.0)[:, None]
    gap = follow(alone, [(f, v, 0) for f in (4, 5) for v in range(4)])
    assert (gap.person_index[[4, 5]] == -1).all() and (gap.person_index[[3, 6]] == 0).all()
    assert gap.sentence.startswith("followed the only person: seen in 4.0 of 4 views")
    leap = alone.copy()
    leap[6:] = moved(leap[6:], 800.0)
    assert (follow(leap, []).person_index[6:] == -1).all()


def test_select_takes_the_followed_detection_of_each_view() -> None:
    keypoints = np.arange(1 * 2 * 2 * 9 * 2, dtype=np.float64).reshape(1, 2, 2, 9, 2)
    followed = FollowedPerson(np.array([[1, -1]]), np.zeros((1, 2), dtype=np.bool_), "")
    selected_px, selected = followed.select(keypoints, np.full((1, 2, 2, 9), 0.7))
    np.testing.assert_array_equal(selected_px[0, 0], keypoints[0, 0, 1])
    assert np.isnan(selected_px[0, 1]).all()
    assert selected.tolist() == [[[0.7] * 9, [0.0] * 9]]


def test_an_association_counts_its_views() -> None:
    association = PersonAssociation(
        np.array([[[0, -1, 1], [-1, -1, -1]]]), np.zeros((1, 2, 3), bool), np.zeros((1, 2, 9, 3))
    )
    assert association.num_views.tolist() == [[2, 0]]
