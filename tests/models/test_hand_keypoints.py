"""The 2D network: pixels where they belong, flipped left hands, and that training works."""

import numpy as np
import pytest
import torch

from assemblyhands_core.models.hand_keypoints import HAND_KEYPOINTS, HandKeypointConfig, HandKeypointNet

TINY = HandKeypointConfig("mobilenetv3_small_050", num_channels=16, image_size_px=64)


@pytest.fixture(scope="module")
def network() -> HandKeypointNet:
    torch.manual_seed(0)
    return HandKeypointNet(TINY).eval()


@torch.no_grad()
def test_a_flipped_left_hand_is_the_flip_of_the_right_one(network: HandKeypointNet) -> None:
    images = torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    right = network(images, torch.tensor([False, False]))
    left = network(images.flip(-1), torch.tensor([True, True]))
    assert right.pixels.shape == (2, 21, 2) and right.heatmaps.shape == (2, 21, 16, 16)
    np.testing.assert_allclose(left.pixels[..., 0], 63 - right.pixels[..., 0], atol=1e-3)
    np.testing.assert_allclose(left.pixels[..., 1], right.pixels[..., 1], atol=1e-3)
    np.testing.assert_allclose(left.confidence, right.confidence, atol=1e-5)


@torch.no_grad()
def test_an_even_heatmap_points_at_the_middle_of_the_image(network: HandKeypointNet) -> None:
    even = HandKeypointNet(TINY).eval()
    for parameter in even.head[-1].parameters():
        parameter.zero_()
    pixels = even(torch.rand(1, 3, 64, 64), torch.tensor([False])).pixels
    np.testing.assert_allclose(pixels, torch.full((1, 21, 2), 31.5), atol=1e-3)


def test_a_few_steps_lower_the_loss() -> None:
    torch.manual_seed(1)
    network, images, is_left = HandKeypointNet(TINY), torch.rand(4, 3, 64, 64), torch.arange(4) % 2 == 1
    pixels, is_valid = torch.rand(4, 21, 2) * 63, torch.rand(4, 21) > 0.1
    pixels[~is_valid] = torch.nan
    optimizer, losses = torch.optim.AdamW(network.parameters(), lr=3e-3), []
    for _ in range(15):
        loss = network.loss(network(images, is_left), pixels, is_valid, is_left)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.85 * losses[0] and np.isfinite(losses).all()


def test_its_encoder_fits_the_annotation_network() -> None:
    from assemblyhands_core.models.mvexonet import SMALL, MVExoNet

    MVExoNet(SMALL).encoder.load_state_dict(HandKeypointNet(HAND_KEYPOINTS).encoder.state_dict())
