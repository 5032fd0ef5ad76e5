"""SVEgoNet: the reference's 2.5D coding up to half a cell, both ways of reading, and that training works."""

from pathlib import Path

import numpy as np
import pytest
import torch

from assemblyhands_core.data.ego_boxes import IDENTITIES
from assemblyhands_core.models import heatmaps as maps
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig

TINY = SVEgoNetConfig("mobilenetv3_small_050", 3, 16, image_size_px=64, num_depths=8)


def test_an_even_heatmap_points_at_the_middle_of_the_crop_and_at_the_wrists_depth() -> None:
    network = SVEgoNet(TINY).eval()
    with torch.no_grad():
        for parameter in network.head[-1].parameters():
            parameter.zero_()
        found = network(torch.rand(2, 3, 64, 64))
    assert found.heatmaps.shape == (2, 42, 8, 16, 16) and found.identity.shape == (2, len(IDENTITIES))
    np.testing.assert_allclose(found.pixels, np.full((2, 42, 2), 31.5), atol=1e-3)
    np.testing.assert_allclose(found.depth_mm, np.zeros((2, 42)), atol=1e-3)


def test_argmax_reads_the_cell_of_the_peak_and_soft_argmax_between_two() -> None:
    heatmaps = torch.full((1, 2, 4, 6, 5), -50.0)
    heatmaps[0, 0, 1, 2, 3] = 9.0
    heatmaps[0, 1, 3, 5, 0], heatmaps[0, 1, 3, 4, 0] = 9.0, 9.0
    np.testing.assert_array_equal(maps.argmax(heatmaps)[0], [[1, 2, 3], [3, 4, 0]])
    np.testing.assert_allclose(maps.soft_argmax(heatmaps)[0], [[1, 2, 3], [3, 4.5, 0]], atol=1e-4)


def test_both_readings_meet_where_a_map_has_one_peak() -> None:
    network = SVEgoNet(TINY).eval()
    with torch.no_grad():
        network.head[-1].weight.mul_(1e4)
        images = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
        soft, hard = network(images), network(images, "argmax")
    is_sharp = soft.confidence > 0.999
    assert is_sharp.float().mean() > 0.5
    np.testing.assert_allclose(hard.pixels[is_sharp], soft.pixels[is_sharp], atol=0.5)
    np.testing.assert_allclose(hard.depth_mm[is_sharp], soft.depth_mm[is_sharp], atol=5.0)


def test_a_few_steps_lower_the_loss_and_holes_give_no_gradient() -> None:
    torch.manual_seed(1)
    network, images = SVEgoNet(TINY), torch.rand(4, 3, 64, 64)
    pixels, depth_mm, is_valid = torch.rand(4, 42, 2) * 63, torch.randn(4, 42) * 40, torch.rand(4, 42) > 0.3
    pixels[~is_valid], depth_mm[~is_valid] = torch.nan, torch.nan
    identity = torch.tensor([0, 1, 2, 0])
    optimizer, losses = torch.optim.AdamW(network.parameters(), lr=3e-3), []
    for _ in range(15):
        loss = network.loss(network(images), pixels, depth_mm, is_valid, identity)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.85 * losses[0] and np.isfinite(losses).all()


def test_cells_are_the_references_but_for_where_they_count_from(golden_dir: Path) -> None:
    """The reference counts from edges of cells (depth) and multiplies pixels (x, y); ours are centres throughout."""
    golden = np.load(golden_dir / "ego_25d.npz")
    scale = golden["K_net"][:, 0, 0] / golden["K_crop"][:, 0, 0]  # of the crop to 256 px
    pixels = golden["joints_crop"] * scale[:, None, None]
    depth = golden["joints_cam"][..., 2]
    depth_mm = np.concatenate((depth[:, :21] - depth[:, 20:21], depth[:, 21:] - depth[:, 41:]), axis=1)
    ours_z = maps.offset_mm_to_cells(torch.tensor(depth_mm), 400.0, 64).numpy()
    ours_yx = maps.pixels_to_cells(torch.tensor(pixels), 4).numpy()
    is_coded = golden["joint_valid_after_crop"] > 0
    reference = golden["joints_heatmap"][is_coded]
    assert len(reference) > 100
    np.testing.assert_allclose(ours_z[is_coded] + 0.5, reference[:, 2], atol=1e-3)
    np.testing.assert_allclose(ours_yx[is_coded][:, ::-1] + 0.375, reference[:, :2], atol=2e-3)


def test_depth_goes_into_cells_and_back() -> None:
    depth_mm = torch.linspace(-200.0, 200.0, 9)
    cells = maps.offset_mm_to_cells(depth_mm, 400.0, 64)
    assert cells[0] == pytest.approx(-0.5) and cells[-1] == pytest.approx(63.5) and cells[4] == pytest.approx(31.5)
    np.testing.assert_allclose(maps.cells_to_offset_mm(cells, 400.0, 64), depth_mm, atol=1e-4)
