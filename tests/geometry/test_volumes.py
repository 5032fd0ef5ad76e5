"""Volumes: where voxels lie, and what views see there, by hand and against a published program's numbers."""

from pathlib import Path

import numpy as np
import pytest
import torch

from assemblyhands_core.geometry.volumes import cube_points_world_mm, unproject_features

# u = x + 1, v = y + 1 for points at depth 1000 mm, on a map of 3 × 2 pixels
CAMERA = torch.tensor([[[[1.0, 0, 0.001, 0], [0, 1.0, 0.001, 0], [0, 0, 0.001, 0]]]], dtype=torch.float64) * 1000


def at(*points: tuple[float, float, float]) -> torch.Tensor:
    return torch.tensor([[[points]]], dtype=torch.float64)


def seen(features: torch.Tensor, *points: tuple[float, float, float], cameras: torch.Tensor = CAMERA) -> list[float]:
    cameras = cameras.expand(-1, features.shape[1], -1, -1)
    return unproject_features(features, cameras, at(*points)).flatten().tolist()


def test_voxels_fill_the_cube_symmetrically_around_its_root() -> None:
    points = cube_points_world_mm(torch.tensor([[10.0, 20.0, 30.0]]), 300.0, 4)
    assert points.shape == (1, 4, 4, 4, 3)
    np.testing.assert_allclose(points[0, :, 0, 0, 0], [10 - 112.5, 10 - 37.5, 10 + 37.5, 10 + 112.5])
    np.testing.assert_allclose(points[0, 2, 3, 0], [10 + 37.5, 20 + 112.5, 30 - 112.5])
    np.testing.assert_allclose(points.flatten(1, 3).mean(dim=1), [[10, 20, 30]], atol=1e-5)


def test_one_view_is_sampled_bilinearly_at_pixel_centres() -> None:
    features = torch.tensor([[[[[1.0, 2, 4], [5, 6, 8]]]]], dtype=torch.float64)
    values = seen(features, (-1, -1, 1000), (0.25, -1, 1000), (0, -0.5, 1000), (0.25, -0.5, 1000))
    np.testing.assert_allclose(values, [1, 2.5, 4, 4.5])


def test_bfloat16_features_are_sampled_where_float32_ones_are() -> None:
    """A ramp of 64 columns: what is read tells the place, to half a step of bfloat16 at that value."""
    ramp = torch.arange(64.0).expand(1, 1, 1, 2, 64)
    for u in (20.06, 31.44, 40.7, 62.2):
        (value,) = seen(ramp.bfloat16(), (u - 1, -0.5, 1000))
        assert value == pytest.approx(u, abs=0.126)
        (value,) = seen(ramp - 40.0, (u - 1, -0.5, 1000))
        (small,) = seen((ramp - 40.0).bfloat16(), (u - 1, -0.5, 1000))
        assert small == pytest.approx(value, abs=0.07)


def test_the_image_ends_half_a_pixel_beyond_the_outermost_centres() -> None:
    features = torch.tensor([[[[[1.0, 2, 4], [5, 6, 8]]]]], dtype=torch.float64)
    values = seen(features, (-1.49, -1.49, 1000), (1.49, 0.49, 1000), (-1.51, -1, 1000), (1.51, -1, 1000))
    np.testing.assert_allclose(values, [1, 8, 0, 0])


def test_points_behind_the_camera_are_seen_by_nobody() -> None:
    features = torch.ones(1, 1, 1, 2, 3, dtype=torch.float64)
    assert seen(features, (-1, -1, 1000), (1, 1, -1000), (0, 0, 0)) == [1, 0, 0]


def test_views_vote_by_softmax_of_what_they_see() -> None:
    features = torch.zeros(1, 2, 1, 2, 3, dtype=torch.float64)
    features[0, 0], features[0, 1] = 1.0, 3.0
    expected = (np.exp(1) * 1 + np.exp(3) * 3) / (np.exp(1) + np.exp(3))
    np.testing.assert_allclose(seen(features, (0, 0, 1000)), [expected])


def test_views_that_do_not_see_a_point_have_no_vote() -> None:
    features = torch.full((1, 2, 1, 2, 3), -2.0, dtype=torch.float64)
    aside = CAMERA.repeat(1, 2, 1, 1)
    aside[0, 1, 0, 3] = 1e6
    assert seen(features, (0, 0, 1000), cameras=aside) == [-2]
    is_view_used = torch.tensor([[False, False]])
    blind = unproject_features(features, CAMERA.expand(1, 2, 3, 4), at((0, 0, 1000)), is_view_used)
    assert blind.tolist() == [[[[[0]]]]]


def test_gradient_of_one_blind_and_one_seeing_view_is_finite() -> None:
    features = torch.randn(1, 2, 2, 2, 3, dtype=torch.float64, requires_grad=True)
    points = at((0.2, -0.4, 1000), (50, 50, 1000))
    used = torch.tensor([[True, False]])
    assert torch.autograd.gradcheck(lambda f: unproject_features(f, CAMERA.expand(1, 2, 3, 4), points, used), features)


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> dict[str, np.ndarray]:
    with np.load(golden_dir / "unproject_softmax.npz") as file:
        return dict(file)


def test_the_reference_program_is_met_under_its_sampling_rule(golden: dict[str, np.ndarray]) -> None:
    features, points = (torch.from_numpy(golden[name]).double() for name in ("features", "coord_volumes"))
    volume = unproject_features(features, torch.from_numpy(golden["proj"]), points, sampling="reference").numpy()
    np.testing.assert_allclose(volume, golden["vol_softmax"], rtol=0, atol=2e-4)
    np.testing.assert_allclose(volume[:, :, ::5, ::5, ::5], golden["vol_softmax_f64_sample"], rtol=0, atol=1e-9)


def test_the_two_sampling_rules_differ_on_noise_as_documented(golden: dict[str, np.ndarray]) -> None:
    features, points = (torch.from_numpy(golden[name]).double() for name in ("features", "coord_volumes"))
    ours = unproject_features(features[:, :2], torch.from_numpy(golden["proj"])[:, :2], points).numpy()
    theirs = unproject_features(features[:, :2], torch.from_numpy(golden["proj"])[:, :2], points, None, "reference")
    assert 0.05 < np.sqrt(np.mean((ours - theirs.numpy()) ** 2)) < 1.0
