"""The fused loop against the readable form: values and gradients, for random rigs, maps and masks."""

import numpy as np
import pytest
import torch
from model_samples import ring_matrices

from assemblyhands_core.geometry.volumes import cube_points_world_mm, unproject_features
from assemblyhands_core.models.fused_unprojection import fused_unproject_features
from assemblyhands_core.models.unprojection import fuse_views, scaled_matrices

Case = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def case(dtype: torch.dtype, height: int = 11, width: int = 14, batch: int = 2, channels: int = 7) -> Case:
    """A cube that leaves the images, some views switched off, one item that no view looks at."""
    generator = torch.Generator().manual_seed(3)
    num_views = 5
    features = torch.randn(batch, num_views, channels, height, width, generator=generator, dtype=dtype)
    points = cube_points_world_mm(torch.zeros(batch, 3, dtype=dtype), 500.0, 8)
    used = torch.rand(batch, num_views, generator=generator) > 0.3
    used[-1] = used[-1] & (batch == 1)
    return features, ring_matrices(batch, num_views, min(height, width)).to(dtype), points, used


def both(arguments: Case) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    features, *others = arguments
    features.requires_grad_()
    results = []
    for form in (unproject_features, fused_unproject_features):
        volume = form(features, *others)
        upstream = torch.randn(volume.shape, generator=torch.Generator().manual_seed(4), dtype=volume.dtype)
        results += [volume.detach(), torch.autograd.grad(volume, features, upstream)[0]]
    return results[0], results[2], results[1], results[3]


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 2e-5)])
def test_values_and_gradients_are_those_of_the_readable_form(dtype: torch.dtype, tolerance: float) -> None:
    plain, fused, plain_gradient, fused_gradient = both(case(dtype))
    assert fused.dtype == dtype and fused.is_contiguous(memory_format=torch.channels_last_3d)
    np.testing.assert_allclose(fused, plain, rtol=0, atol=tolerance)
    np.testing.assert_allclose(fused_gradient, plain_gradient, rtol=0, atol=tolerance)
    assert 0.05 < (plain[0] == 0).double().mean() < 0.95 and plain_gradient[0].abs().max() > 0.1
    assert not plain[1].any() and not fused[1].any() and not fused_gradient[1].any()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_maps_of_one_row_or_column_do_not_read_past_their_end(height: int, width: int) -> None:
    features, matrices, points, used = case(torch.float64, height, width, batch=1)
    plain, fused, plain_gradient, fused_gradient = both((features, matrices, points / 20, used))
    np.testing.assert_allclose(fused, plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fused_gradient, plain_gradient, rtol=0, atol=1e-12)


def test_large_values_do_not_overflow() -> None:
    features, *others = case(torch.float32)
    plain, fused, *_ = both((features.mul(200.0), *others))
    np.testing.assert_allclose(fused, plain, rtol=1e-5, atol=1e-3)


def test_gradient_by_finite_differences() -> None:
    features, matrices, points, used = case(torch.float64, height=4, width=4, channels=2)
    points = points[:, ::4, ::4, ::4].contiguous()
    features = features[:1].clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda values: fused_unproject_features(values, matrices[:1], points[:1], used[:1]), features
    )


def test_nan_features_stay_visible() -> None:
    features, matrices, points, used = case(torch.float32, batch=1)
    volume = fused_unproject_features(torch.full_like(features, torch.nan), matrices, points, used)
    seen = unproject_features(torch.ones_like(features), matrices, points, used) > 0
    assert volume[seen].isnan().all() and not volume[~seen].any()


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    threads = torch.get_num_threads()
    try:
        results = []
        for count in (1, 2):
            torch.set_num_threads(count)
            results.append(both(case(torch.float32)))
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(one, two) for one, two in zip(*results, strict=True))


def test_bfloat16_comes_back_as_bfloat16() -> None:
    features, *others = case(torch.float32)
    volume = fused_unproject_features(features.bfloat16(), *others)
    assert volume.dtype == torch.bfloat16
    np.testing.assert_allclose(volume.float(), unproject_features(features, *others), rtol=0.02, atol=0.02)


def test_auto_is_the_fused_form_on_a_cpu() -> None:
    arguments = case(torch.float32)
    assert torch.equal(fuse_views(*arguments), fused_unproject_features(*arguments))
    assert torch.equal(fuse_views(*arguments, form="plain"), unproject_features(*arguments))


def test_a_device_without_fused_form_is_refused_by_name() -> None:
    features, *others = (tensor.to("meta") for tensor in case(torch.float32))
    with pytest.raises(ValueError, match="no fused unprojection for device meta"):
        fuse_views(features, *others, form="fused")


def test_matrices_of_smaller_maps_follow_the_rule_of_pixel_centres() -> None:
    matrices = ring_matrices(1, 2, 64)
    point = torch.tensor([10.0, -20.0, 5.0, 1.0], dtype=torch.float64)
    large, small = matrices @ point, scaled_matrices(matrices, 4) @ point
    pixel = large[..., :2] / large[..., 2:]
    np.testing.assert_allclose(small[..., :2] / small[..., 2:], (pixel + 0.5) / 4 - 0.5, atol=1e-9)
