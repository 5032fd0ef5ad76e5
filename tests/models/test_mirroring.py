"""Mirroring: what is seen, where it is seen and what comes out, all turned round together."""

import numpy as np
import torch
from model_samples import ring_matrices

from assemblyhands_core.geometry.volumes import cube_points_world_mm, unproject_features
from assemblyhands_core.models.mirroring import mirrored_images, mirrored_matrices, mirrored_pixels, mirrored_points

YES, NO = torch.tensor([True]), torch.tensor([False])


def pixels_of(matrices: torch.Tensor, point_mm: torch.Tensor) -> torch.Tensor:
    homogeneous = matrices @ torch.cat((point_mm, torch.ones(1, dtype=point_mm.dtype)))
    return homogeneous[..., :2] / homogeneous[..., 2:]


def test_a_mirrored_point_is_seen_at_the_mirrored_pixel() -> None:
    matrices, point = ring_matrices(1, 4, 64), torch.tensor([30.0, -20.0, 50.0], dtype=torch.float64)
    mirrored = pixels_of(mirrored_matrices(matrices, 64, YES), mirrored_points(point[None], YES)[0])
    np.testing.assert_allclose(mirrored, mirrored_pixels(pixels_of(matrices, point), 64, YES), atol=1e-9)


def test_the_matrix_is_that_of_the_mirrored_rotation_translation_and_centre() -> None:
    """S R S, S t and W - 1 - c_x, written out."""
    matrix = ring_matrices(1, 1, 64)
    K = torch.tensor([[200.0, 0, 20], [0, 210, 40], [0, 0, 1]], dtype=torch.float64)
    pose = torch.linalg.inv(torch.tensor([[204.8, 0, 31.5], [0, 204.8, 31.5], [0, 0, 1]]).double()) @ matrix[0, 0]
    S = torch.diag(torch.tensor([-1.0, 1, 1], dtype=torch.float64))
    mirrored_K = K.clone()
    mirrored_K[0, 2] = 63 - K[0, 2]
    expected = mirrored_K @ torch.cat((S @ pose[:, :3] @ S, S @ pose[:, 3:]), dim=1)
    actual = mirrored_matrices((K @ pose)[None, None], 64, YES)[0, 0]
    np.testing.assert_allclose(actual, expected, atol=1e-9)
    assert torch.linalg.det(S @ pose[:, :3] @ S) > 0  # still a rotation


def test_everything_is_its_own_inverse_and_leaves_other_items_alone() -> None:
    generator = torch.Generator().manual_seed(0)
    images, points = torch.rand(2, 3, 3, 4, 5, generator=generator), torch.randn(2, 21, 3, generator=generator)
    matrices, pixels = torch.randn(2, 3, 3, 4, generator=generator), torch.rand(2, 21, 2, generator=generator)
    flags = torch.tensor([True, False])
    for function, value in (
        (mirrored_images, images),
        (mirrored_points, points),
        (lambda value, flags: mirrored_matrices(value, 64, flags), matrices),
        (lambda value, flags: mirrored_pixels(value, 64, flags), pixels),
    ):
        once = function(value, flags)
        assert torch.equal(once[1], value[1]) and not torch.equal(once[0], value[0])
        np.testing.assert_allclose(function(once, flags), value, atol=2e-5)


def test_the_volume_of_a_mirrored_world_is_the_mirrored_volume() -> None:
    features = torch.randn(1, 4, 3, 16, 16, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    matrices, root = ring_matrices(1, 4, 16), torch.tensor([[20.0, 10.0, -30.0]], dtype=torch.float64)

    def volume(flags: torch.Tensor) -> torch.Tensor:
        points = cube_points_world_mm(mirrored_points(root, flags), 300.0, 8)
        return unproject_features(mirrored_images(features, flags), mirrored_matrices(matrices, 16, flags), points)

    np.testing.assert_allclose(volume(YES).flip(2), volume(NO), atol=1e-9)
