"""The image encoder, and that timm can be imported at all."""

import importlib
import subprocess
import sys

import pytest
import torch

from assemblyhands_core.models.encoder import STRIDE, ImageEncoder


def test_maps_are_a_quarter_of_the_images_in_channels_last_order() -> None:
    encoder = ImageEncoder("mobilenetv3_small_050", num_channels=8, num_levels=3).eval()
    features = encoder(torch.rand(2, 3, 32, 48))
    assert features.shape == (2, 8, 32 // STRIDE, 48 // STRIDE)
    assert features.is_contiguous(memory_format=torch.channels_last)


def test_layers_that_no_level_needs_are_left_out() -> None:
    counts = [
        sum(parameter.numel() for parameter in ImageEncoder("tf_efficientnet_lite0", 32, levels).parameters())
        for levels in (3, 4)
    ]
    assert counts[0] < 0.8e6 and 2.9e6 < counts[1] < 3.2e6


def test_images_are_normalised_by_the_backbone_s_own_statistics() -> None:
    torch.manual_seed(0)
    encoder = ImageEncoder("tf_efficientnet_lite0", 8, 3).eval()
    images, seen = torch.rand(1, 3, 32, 32), []
    encoder.backbone.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    encoder(images)
    torch.testing.assert_close(seen[0], images * 2 - 1)  # mean and deviation of this backbone are 1/2


def test_a_backbone_without_the_strides_is_refused() -> None:
    with pytest.raises(ValueError, match="vit_tiny_patch16_224 has levels of strides"):
        ImageEncoder("vit_tiny_patch16_224", 8, 3)


def test_torchvision_can_be_imported() -> None:
    assert importlib.import_module("torchvision").__version__


def test_the_core_does_not_import_torch_before_a_network_is_asked_for() -> None:
    program = (
        "import sys, assemblyhands_core.geometry.cameras, assemblyhands_core.detectors.registry, "
        "assemblyhands_core.models; sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
