"""Images to feature maps: a timm backbone and a neck that brings its levels together at a quarter of the size."""

from typing import Any, Final

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from assemblyhands_core.models import torchvision_operators  # noqa: F401  (before timm)

import timm  # isort: skip

STRIDE: Final = 4


class ImageEncoder(nn.Module):
    """A timm backbone, its levels of stride 4, 8, 16 … added from coarse to fine, and one convolution.

    Args:
        backbone: Any name that timm knows and can give features of.
        num_channels: Channels of the feature maps.
        num_levels: Levels used; 3 ends at stride 16, and deeper layers of the backbone are left out.

    Source: paper, Sec. 3.1 ("EfficientNet as an encoder to extract compact 2D features"). The neck is ours.
    """

    def __init__(self, backbone: str, num_channels: int, num_levels: int) -> None:
        super().__init__()
        if not timm.is_model(backbone):  # whose other names lead to files and to the network
            raise ValueError(f"Backbone {backbone} is none that timm has: choose among timm.list_models().")
        levels = tuple(range(1, 1 + num_levels))
        self.mean: Tensor
        self.std: Tensor
        # The "getter" leaves layers out that no level needs: 0.7 of 3.0 million parameters stay of EfficientNet-Lite0.
        self.backbone: Any = timm.create_model(backbone, features_only=True, feature_cls="getter", out_indices=levels)
        strides = self.backbone.feature_info.reduction()
        if strides != [STRIDE * 2**level for level in range(num_levels)]:
            raise ValueError(f"Backbone {backbone} has levels of strides {strides}, not 4, 8, 16 …: choose another.")
        config = self.backbone.pretrained_cfg
        self.register_buffer("mean", torch.tensor(config["mean"])[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(config["std"])[:, None, None], persistent=False)
        self.laterals = nn.ModuleList(
            nn.Conv2d(channels, num_channels, 1) for channels in self.backbone.feature_info.channels()
        )
        self.output = nn.Conv2d(num_channels, num_channels, 3, padding=1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(
        self, images: Float[Tensor, "image 3 height width"]
    ) -> Float[Tensor, "image channel feature_height feature_width"]:
        """Return feature maps at a quarter of the size.

        Args:
            images: RGB in [0, 1]; the backbone's own mean and deviation are applied here.
        """
        normalised = ((images - self.mean) / self.std).contiguous(memory_format=torch.channels_last)
        levels = self.backbone(normalised)
        merged = self.laterals[-1](levels[-1])
        for lateral, level in zip(reversed(self.laterals[:-1]), reversed(levels[:-1]), strict=True):
            merged = lateral(level) + F.interpolate(merged, size=level.shape[-2:], mode="nearest")
        features: Tensor = self.output(F.relu(merged))
        return features
