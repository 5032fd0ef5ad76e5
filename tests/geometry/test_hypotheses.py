"""Two-view hypotheses: every pair has its turn, and their number does not grow with the square of the views."""

from collections.abc import Callable

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.hypotheses import NUM_PAIRS, _pair_groups, _pairs, _truncated_cost, best_hypotheses
from assemblyhands_core.geometry.sightlines import sightlines


@pytest.mark.parametrize("num_views", [2, 3, 8, 9, 16, 40])
def test_groups_hold_every_pair_and_their_number_is_bounded(num_views: int) -> None:
    num_pairs = num_views * (num_views - 1) // 2
    groups = _pair_groups(num_views, NUM_PAIRS)
    assert len(groups) == min(NUM_PAIRS, num_pairs)
    np.testing.assert_array_equal(np.unique(groups), np.arange(num_pairs))
    assert groups.shape[1] == -(-num_pairs // len(groups))
    first, second = _pairs(num_views).T
    assert (first < second).all() and len(set(zip(first.tolist(), second.tolist(), strict=True))) == num_pairs


@pytest.mark.parametrize("num_views", [2, 6, 16])
def test_the_winner_is_the_point_itself(make_rig: Callable[..., list[Camera]], num_views: int) -> None:
    cameras = make_rig(num_views)
    points = np.random.default_rng(0).uniform(-150, 150, (30, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1)
    found, has_parallax = best_hypotheses(sightlines(pixels, cameras, np.ones((30, num_views))), 10.0, 0.01)
    assert has_parallax.all()
    np.testing.assert_allclose(found, points, rtol=0, atol=1e-8)


def test_hard_points_get_every_pair(make_rig: Callable[..., list[Camera]]) -> None:
    # only two of 16 views tell the truth, and not the pair that its group would choose first
    cameras = make_rig(16)
    generator = np.random.default_rng(3)
    points = generator.uniform(-150, 150, (60, 3))
    pixels = np.stack([camera.project(points) for camera in cameras], axis=1)
    is_true = generator.permuted(np.tile(np.arange(16) < 3, (60, 1)), axis=1)
    pixels[~is_true] = generator.uniform((0, 0), (1920, 1080), pixels.shape)[~is_true]
    found, _ = best_hypotheses(sightlines(pixels, cameras, np.ones((60, 16))), 10.0, 0.01)
    assert (np.linalg.norm(found - points, axis=1) < 1e-6).mean() > 0.9


def test_no_ray_pairs_no_hypothesis(make_rig: Callable[..., list[Camera]]) -> None:
    pixels = np.full((2, 3, 2), np.nan)
    pixels[0, 1] = (900.0, 500.0)
    found, has_parallax = best_hypotheses(sightlines(pixels, make_rig(3), np.ones((2, 3))), 10.0, 0.01)
    assert np.isnan(found).all() and not has_parallax.any()


def test_two_rays_that_miss_each_other_have_the_least_pixel_error(make_camera: Callable[..., Camera]) -> None:
    # one camera ten times as near as the other: 4 px there are 0.4 px here, and that is where the error should go
    cameras = [
        make_camera("Pinhole", np.array([0.0, 0.0, 200.0])),
        make_camera("Pinhole", np.array([2000.0, 0.0, 0.0])),
    ]
    pixels = np.stack([camera.project(np.zeros((1, 3))) for camera in cameras], axis=1)
    pixels[0, 0] += _across(cameras)
    found, _ = best_hypotheses(sightlines(pixels, cameras, np.ones((1, 2))), 10.0, 0.01)
    errors = [np.linalg.norm(camera.project(found) - pixels[:, view]) for view, camera in enumerate(cameras)]
    # least squares of x + 10 y = 4: x = 4 / 101, y = 40 / 101
    np.testing.assert_allclose(errors, [4 / 101, 40 / 101], rtol=0.02)


def _across(cameras: list[Camera]) -> np.ndarray:
    """Return 4 px across the epipolar line of the origin in the first camera."""
    along = cameras[0].project(0.01 * cameras[1].center_world_mm) - cameras[0].project(np.zeros(3))
    return np.asarray(4 * np.array([-along[1], along[0]]) / np.linalg.norm(along))


def test_a_view_behind_which_a_candidate_lies_does_not_vote_for_it(make_camera: Callable[..., Camera]) -> None:
    camera = make_camera("Pinhole", np.array([0.0, 0.0, 500.0]))
    lines = sightlines(camera.project(np.zeros((1, 1, 3))), [camera], np.ones((1, 1)))
    candidates = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1000.0], [np.nan] * 3]])
    np.testing.assert_allclose(_truncated_cost(lines, candidates, 10.0), [[0.0, 1.0, np.inf]], rtol=0, atol=1e-6)
