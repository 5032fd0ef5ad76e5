"""MVExoNet: symmetries that hold for any weights, and that training works."""

import dataclasses
from typing import NamedTuple

import numpy as np
import pytest
import torch
from model_samples import ring_matrices

from assemblyhands_core.models.mirroring import mirrored_images, mirrored_matrices, mirrored_points
from assemblyhands_core.models.mvexonet import BASE, SMALL, HandEstimate, MVExoNet, MVExoNetConfig

TINY = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=32, num_voxels=8, v2v="slim")


class Sample(NamedTuple):
    images: torch.Tensor
    P_pixel_from_world: torch.Tensor
    is_view_used: torch.Tensor
    root_world_mm: torch.Tensor
    is_left: torch.Tensor


@pytest.fixture(scope="module")
def network() -> MVExoNet:
    torch.manual_seed(0)
    network = MVExoNet(TINY)
    with torch.no_grad():
        network.train()(*sample(seed=5))  # statistics of the batch norms
    return network.eval()


def sample(batch: int = 3, num_views: int = 4, seed: int = 0) -> Sample:
    generator = torch.Generator().manual_seed(seed)
    images = torch.rand(batch, num_views, 3, 32, 32, generator=generator)
    used = torch.ones(batch, num_views, dtype=torch.bool)
    used[0, 1] = used[2, 0] = False
    root_mm = torch.randn(batch, 3, generator=generator) * 10
    return Sample(images, ring_matrices(batch, num_views, 32).float(), used, root_mm, torch.arange(batch) % 2 == 1)


@torch.no_grad()
def estimate(network: MVExoNet, inputs: Sample) -> HandEstimate:
    result: HandEstimate = network(*inputs)
    return result


def test_shapes_units_and_ranges(network: MVExoNet) -> None:
    inputs = sample()
    result = estimate(network, inputs)
    assert result.joints_world_mm.shape == (3, 21, 3) and result.heatmaps.shape == (3, 21, 8, 8, 8)
    assert ((result.confidence >= 0) & (result.confidence <= 1 + 1e-6)).all()
    assert ((result.joints_world_mm - inputs.root_world_mm[:, None]).abs() <= 150).all()
    assert result.joints_world_mm.std() > 0.1


def test_views_that_are_not_used_and_the_order_of_views_do_not_matter(network: MVExoNet) -> None:
    inputs = sample()
    expected = estimate(network, inputs).joints_world_mm
    blanked = torch.where(inputs.is_view_used[..., None, None, None], inputs.images, 0.5)
    blind = inputs._replace(images=blanked)
    np.testing.assert_allclose(estimate(network, blind).joints_world_mm, expected, atol=1e-3)
    turned = Sample(*(tensor.flip(1) for tensor in inputs[:3]), *inputs[3:])
    np.testing.assert_allclose(estimate(network, turned).joints_world_mm, expected, atol=1e-3)
    darker = estimate(network, inputs._replace(images=inputs.images * 0.3)).joints_world_mm
    assert (darker - expected).abs().max() > 1e-2


def test_a_mirrored_left_hand_is_the_mirror_of_the_right_one(network: MVExoNet) -> None:
    right = sample()._replace(is_left=torch.zeros(3, dtype=torch.bool))
    flags = torch.ones(3, dtype=torch.bool)
    left = Sample(
        mirrored_images(right.images, flags),
        mirrored_matrices(right.P_pixel_from_world, 32, flags),
        right.is_view_used,
        mirrored_points(right.root_world_mm, flags),
        flags,
    )
    mirrored = mirrored_points(estimate(network, right).joints_world_mm, flags)
    np.testing.assert_allclose(estimate(network, left).joints_world_mm, mirrored, atol=1e-3)


def test_left_hands_are_learnt_as_they_are_where_the_config_says_so(network: MVExoNet) -> None:
    plain = MVExoNet(dataclasses.replace(TINY, is_left_mirrored=False)).eval()
    plain.load_state_dict(network.state_dict())
    left, right = (sample()._replace(is_left=torch.full((3,), side)) for side in (True, False))
    assert torch.equal(estimate(plain, left).joints_world_mm, estimate(plain, right).joints_world_mm)
    assert not torch.equal(estimate(network, left).joints_world_mm, estimate(network, right).joints_world_mm)


def test_moving_the_world_moves_the_joints(network: MVExoNet) -> None:
    inputs, shift_mm = sample(), torch.tensor([500.0, -300.0, 200.0])
    P = inputs.P_pixel_from_world.clone()
    P[..., 3] -= P[..., :3] @ shift_mm
    moved = inputs._replace(P_pixel_from_world=P, root_world_mm=inputs.root_world_mm + shift_mm)
    is_right = torch.zeros(3, dtype=torch.bool)
    expected = estimate(network, inputs._replace(is_left=is_right)).joints_world_mm + shift_mm
    np.testing.assert_allclose(estimate(network, moved._replace(is_left=is_right)).joints_world_mm, expected, atol=0.05)


def test_a_hand_that_no_view_sees_gives_numbers_all_the_same(network: MVExoNet) -> None:
    inputs = sample()
    some, nobody = inputs.is_view_used.clone(), torch.zeros_like(inputs.is_view_used)
    some[1] = False
    for used in (some, nobody):
        assert torch.isfinite(estimate(network, inputs._replace(is_view_used=used)).joints_world_mm).all()


def test_both_forms_of_fusion_give_the_same(network: MVExoNet) -> None:
    plain = MVExoNet(TINY, form="plain").eval()
    plain.load_state_dict(network.state_dict())
    fused, readable = estimate(network, sample()), estimate(plain, sample())
    np.testing.assert_allclose(fused.joints_world_mm, readable.joints_world_mm, atol=1e-3)


def test_the_loss_of_exact_heatmaps_is_the_targets_entropy() -> None:
    network = MVExoNet(TINY)
    root = torch.tensor([[5.0, 6.0, 7.0]] * 2)
    is_left, is_valid = torch.tensor([False, True]), torch.ones(2, 21, dtype=torch.bool)
    voxel = torch.full((2, 21, 3), 2.0)
    heatmaps = torch.full((2, 21, 8, 8, 8), -50.0)
    heatmaps[:, :, 2, 2, 2] = 50.0
    exact = network._read(heatmaps, mirrored_points(root, is_left), is_left)
    np.testing.assert_allclose(exact.cells, voxel, atol=1e-4)
    offset_mm = (2.5 - 4) * 300 / 8
    np.testing.assert_allclose(exact.joints_world_mm[0, 0], root[0] + offset_mm, atol=1e-3)
    expected = root[1] + offset_mm * torch.tensor([-1.0, 1, 1])
    np.testing.assert_allclose(exact.joints_world_mm[1, 0], expected, atol=1e-3)
    assert network.loss(exact, exact.joints_world_mm, is_valid, root, is_left).item() < 1e-4
    shifted = exact.joints_world_mm + 37.5
    assert network.loss(exact, shifted, is_valid, root, is_left).item() > 0.05 * 37.5


def train(steps: int) -> tuple[list[float], MVExoNet]:
    torch.manual_seed(1)
    network, inputs = MVExoNet(TINY), sample()
    true_mm = inputs.root_world_mm[:, None] + torch.randn(3, 21, 3) * 40
    is_valid = torch.rand(3, 21) > 0.1
    true_mm[~is_valid] = torch.nan
    optimizer, losses = torch.optim.AdamW(network.parameters(), lr=3e-3), []
    for _ in range(steps):
        result = network(*inputs)
        loss = network.loss(result, true_mm, is_valid, inputs.root_world_mm, inputs.is_left)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    return losses, network


def test_a_few_steps_lower_the_loss_and_reach_every_part() -> None:
    losses, network = train(12)
    assert losses[-1] < 0.85 * losses[0] and np.isfinite(losses).all()
    for part in (network.encoder.backbone, network.encoder.laterals, network.v2v):
        assert any(parameter.grad is not None and parameter.grad.abs().max() > 0 for parameter in part.parameters())


def test_training_repeats_exactly() -> None:
    (losses, one), (again, two) = train(3), train(3)
    assert losses == again
    assert all(torch.equal(a, b) for a, b in zip(one.state_dict().values(), two.state_dict().values(), strict=True))


def test_the_sizes_are_the_paper_s_and_a_laptop_s() -> None:
    assert (BASE.cube_side_mm, BASE.num_voxels, BASE.image_size_px, BASE.v2v) == (300.0, 64, 256, "reference")
    assert (SMALL.cube_side_mm, SMALL.num_voxels, SMALL.image_size_px, SMALL.v2v) == (300.0, 32, 128, "slim")
    small = sum(parameter.numel() for parameter in MVExoNet(SMALL).parameters())
    assert 1.0e6 < small < 3.0e6  # in float32 below 20 MB
