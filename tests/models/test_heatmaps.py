"""Heatmaps against closed forms, hand-worked numbers and a published program's."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.models import heatmaps as maps

ROOT_MM = torch.tensor([[10.0, -20.0, 700.0]], dtype=torch.float64)


def peak(shape: tuple[int, ...], cell: tuple[int, ...], logit: float = 100.0) -> torch.Tensor:
    heatmap = torch.zeros(1, 1, *shape, dtype=torch.float64)
    heatmap[(0, 0, *cell)] = logit
    return heatmap


def test_a_sharp_peak_is_found_in_the_order_of_the_axes() -> None:
    np.testing.assert_allclose(maps.soft_argmax(peak((4, 5, 6), (3, 1, 5))), [[[3, 1, 5]]], atol=1e-9)
    np.testing.assert_allclose(maps.soft_argmax(peak((4, 6), (2, 5))), [[[2, 5]]], atol=1e-9)


def test_a_flat_map_gives_its_middle() -> None:
    np.testing.assert_allclose(maps.soft_argmax(torch.zeros(1, 2, 4, 5, 6)), [[[1.5, 2, 2.5]] * 2], atol=1e-6)


def test_two_cells_share_by_softmax_and_temperature() -> None:
    heatmap = torch.full((1, 1, 1, 3), -1e4, dtype=torch.float64)
    heatmap[0, 0, 0, 0], heatmap[0, 0, 0, 2] = 1.0, 2.0
    np.testing.assert_allclose(maps.soft_argmax(heatmap)[0, 0, 1], 2 / (1 + math.exp(-1)))
    np.testing.assert_allclose(maps.soft_argmax(heatmap, temperature=0.1)[0, 0, 1], 2 / (1 + math.exp(-10)))


def test_confidence_is_the_probability_near_the_joint() -> None:
    sharp = maps.read_joints(peak((8, 8, 8), (3, 3, 3)), radius_cells=1.0)
    flat = maps.read_joints(torch.zeros(1, 1, 9, 9, 9), radius_cells=1.1)
    rivals = maps.read_joints(peak((1, 9), (0, 0)) + peak((1, 9), (0, 8)), radius_cells=2.0)
    np.testing.assert_allclose(sharp.confidence, [[1.0]], atol=1e-9)
    np.testing.assert_allclose(flat.confidence, [[7 / 729]], atol=1e-6)  # the middle and its six neighbours
    np.testing.assert_allclose(rivals.confidence, [[0.0]], atol=1e-9)


def test_confidence_takes_no_gradient() -> None:
    heatmaps = torch.randn(1, 2, 4, 4, 4, requires_grad=True)
    joints = maps.read_joints(heatmaps, radius_cells=1.0)
    assert joints.cells.requires_grad and not joints.confidence.requires_grad


def test_cells_are_where_the_cube_has_its_voxels() -> None:
    from assemblyhands_core.geometry.volumes import cube_points_world_mm

    points_mm = cube_points_world_mm(ROOT_MM, 300.0, 8)[:, 2, 7, 0][:, None]
    cells = maps.world_mm_to_cells(points_mm, ROOT_MM, 300.0, 8)
    np.testing.assert_allclose(cells, [[[2, 7, 0]]], atol=1e-9)
    np.testing.assert_allclose(maps.cells_to_world_mm(cells, ROOT_MM, 300.0, 8), points_mm, atol=1e-9)


def test_pixels_of_cells_follow_the_rule_of_pixel_centres() -> None:
    cells = torch.tensor([[[0.0, 2.0], [1.25, -0.5]]])
    pixels = maps.cells_to_pixels(cells, 4)
    np.testing.assert_allclose(pixels, [[[9.5, 1.5], [-0.5, 6.5]]])
    np.testing.assert_allclose(maps.pixels_to_cells(pixels, 4), cells)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(0, 1)] * 3), st.tuples(*[st.integers(1, 5)] * 3))
def test_the_mean_of_a_target_is_its_joint(share: tuple[float, ...], shape: tuple[int, ...]) -> None:
    cell = torch.tensor([[[part * (size - 1) for part, size in zip(share, shape, strict=True)]]], dtype=torch.float64)
    target = maps.target_heatmaps(cell, shape)
    assert target.shape == (1, 1, *shape) and target.min() >= -1e-12
    np.testing.assert_allclose(target.sum(), 1.0)
    np.testing.assert_allclose(maps.soft_argmax((target + 1e-300).log()), cell, atol=1e-6)


def test_trilinear_weights_by_hand() -> None:
    target = maps.target_heatmaps(torch.tensor([[[1.25, 0.5, 2.0]]]), (3, 3, 3))[0, 0]
    expected = {(1, 0, 2): 0.375, (1, 1, 2): 0.375, (2, 0, 2): 0.125, (2, 1, 2): 0.125}
    assert {tuple(place): target[tuple(place)].item() for place in target.nonzero().tolist()} == expected


def test_cross_entropy_is_that_of_the_target_heatmap() -> None:
    generator = torch.Generator().manual_seed(0)
    heatmaps = torch.randn(2, 3, 4, 5, 6, generator=generator)
    cells = torch.rand(2, 3, 3, generator=generator) * torch.tensor([3.0, 4.0, 5.0])
    is_valid = torch.tensor([[True, True, False], [True, False, True]])
    target = maps.target_heatmaps(cells, (4, 5, 6)).flatten(2)
    entropies = -(target * heatmaps.flatten(2).log_softmax(dim=-1)).sum(dim=-1)
    np.testing.assert_allclose(maps.cross_entropy(heatmaps, cells, is_valid), entropies[is_valid].mean(), rtol=1e-5)


def test_joints_off_the_map_or_invalid_do_not_enter_losses_nor_gradients() -> None:
    heatmaps = torch.zeros(1, 3, 2, 2, requires_grad=True)
    cells = torch.tensor([[[0.0, 1.4], [0.0, 1.6], [torch.nan, torch.nan]]])
    loss = maps.cross_entropy(heatmaps, cells, torch.tensor([[True, True, False]]))
    loss.backward()
    np.testing.assert_allclose(loss.item(), math.log(4), rtol=1e-6)
    assert heatmaps.grad is not None and heatmaps.grad[0, 0].any() and not heatmaps.grad[0, 1:].any()
    assert maps.cross_entropy(heatmaps, cells, torch.zeros(1, 3, dtype=torch.bool)).item() == 0


def test_position_loss_is_the_mean_absolute_coordinate_error() -> None:
    predicted = torch.zeros(1, 2, 3, requires_grad=True)
    true = torch.tensor([[[1.0, -2.0, 6.0], [torch.nan] * 3]])
    loss = maps.position_loss(predicted, true, torch.tensor([[True, False]]))
    loss.backward()
    assert loss.item() == 3
    np.testing.assert_allclose(predicted.grad, [[[-1 / 3, 1 / 3, -1 / 3], [0, 0, 0]]], rtol=1e-6)


def test_gradients_by_finite_differences() -> None:
    heatmaps = torch.randn(1, 2, 3, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda values: maps.soft_argmax(values), heatmaps)


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> dict[str, torch.Tensor]:
    with np.load(golden_dir / "softargmax.npz") as file:
        return {name: torch.from_numpy(file[name]).double() for name in file if file[name].ndim}


def corner_grid_mm(cells: torch.Tensor, coordinates_mm: torch.Tensor) -> torch.Tensor:
    """The reference's grid has voxels at the cube's corners: its first voxel and its steps from its coordinates."""
    first, step = coordinates_mm[:, 0, 0, 0], coordinates_mm[:, 1, 1, 1] - coordinates_mm[:, 0, 0, 0]
    return first[:, None] + cells * step[:, None]


@pytest.mark.parametrize(("name", "factor"), [("kp3d_softmax", 1.0), ("kp3d_softmax_x10", 10.0)])
def test_positions_of_the_reference_program(golden: dict[str, torch.Tensor], name: str, factor: float) -> None:
    cells = maps.soft_argmax(golden["volumes"] * factor)
    np.testing.assert_allclose(corner_grid_mm(cells, golden["coord_volumes"]), golden[name], rtol=0, atol=2e-3)


def test_cells_of_the_reference_program(golden: dict[str, torch.Tensor]) -> None:
    np.testing.assert_allclose(maps.soft_argmax(golden["volumes"]), golden["idx3d_softmax"], rtol=0, atol=1e-4)
    pixels = maps.cells_to_pixels(maps.soft_argmax(golden["heatmaps2d"]), 1)
    np.testing.assert_allclose(pixels, golden["xy2d_softmax"], rtol=0, atol=1e-4)


def test_cross_entropy_of_the_reference_program(golden: dict[str, torch.Tensor], golden_dir: Path) -> None:
    """The reference takes the nearest voxel for the target and adds 1e-6 to its probability."""
    grid, volumes = golden["coord_volumes"], golden["volumes"]
    first, step = grid[:, 0, 0, 0, None], (grid[:, 1, 1, 1] - grid[:, 0, 0, 0])[:, None]
    nearest = ((golden["ce_gt"] - first) / step).round().clamp(min=0, max=15)
    probabilities = [
        (-maps.cross_entropy(volumes[b, j][None, None], nearest[b, j][None, None], torch.ones(1, 1).bool())).exp()
        for b in range(2)
        for j in range(5)
    ]
    with np.load(golden_dir / "softargmax.npz") as file:
        np.testing.assert_allclose(
            -(torch.stack(probabilities) + 1e-6).log().mean(), file["ce_loss"], rtol=0, atol=1e-5
        )
