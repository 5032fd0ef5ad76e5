"""The 2D network: a crop of one hand in, its 21 joints in pixels and a confidence for each out.

Source: paper, Sec. 3.1 ("2D + Triangulation"): an EfficientNet encoder with heatmaps. Its encoder has the shape of
MVExoNet's, whose training may start from it.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.models import heatmaps as maps
from assemblyhands_core.models.encoder import STRIDE, ImageEncoder
from assemblyhands_core.models.mirroring import mirrored_images, mirrored_pixels


@dataclass(frozen=True)
class HandKeypointConfig:
    """What determines the network's shape and reading.

    Attributes:
        backbone: timm name of the image encoder.
        num_levels: Levels of the backbone that are used; 3 ends at stride 16.
        num_channels: Channels of the feature maps.
        image_size_px: Side of the square crops.
        num_joints: Heatmaps.
        is_left_mirrored: Whether left hands are flipped into right ones, or learnt as they are.
        confidence_radius_px: Confidence is the probability within this distance of the joint.
    """

    backbone: str = "tf_efficientnet_lite0"
    num_levels: int = 3
    num_channels: int = 32
    image_size_px: int = 128
    num_joints: int = NUM_JOINTS
    is_left_mirrored: bool = True
    confidence_radius_px: float = 8.0


HAND_KEYPOINTS: Final = HandKeypointConfig()

POSITION_WEIGHT: Final = 0.05  # per px
ENTROPY_WEIGHT: Final = 0.5


class KeypointEstimate(NamedTuple):
    """What the network says about each crop.

    Attributes:
        pixels: Joints (x, y) in the crop, integers at pixel centres.
        confidence: Probability within `confidence_radius_px` of each, in [0, 1].
        cells: The joints (y, x) in cells of the heatmaps, which are flipped for left hands where the config says so.
        heatmaps: Logits, at a quarter of the crop's size.
    """

    pixels: Float[Tensor, "batch joint 2"]
    confidence: Float[Tensor, "batch joint"]
    cells: Float[Tensor, "batch joint 2"]
    heatmaps: Float[Tensor, "batch joint height width"]


class HandKeypointNet(nn.Module):
    """Joints of one hand in crops.

    Args:
        config: `HAND_KEYPOINTS` or one's own.
    """

    def __init__(self, config: HandKeypointConfig = HAND_KEYPOINTS) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.backbone, config.num_channels, config.num_levels)
        self.head = nn.Sequential(
            nn.BatchNorm2d(config.num_channels),
            nn.ReLU(inplace=True),
            nn.Conv2d(config.num_channels, config.num_joints, 1),
        )

    def forward(
        self, images: Float[Tensor, "batch 3 height width"], is_left: Bool[Tensor, " batch"]
    ) -> KeypointEstimate:
        """Find the joints in crops.

        Args:
            images: RGB in [0, 1].
            is_left: Whether the hand is a left one.
        """
        is_mirrored = self._is_mirrored(is_left)
        heatmaps = self.head(self.encoder(mirrored_images(images, is_mirrored)))
        cells, confidence = maps.read_joints(heatmaps, self.config.confidence_radius_px / STRIDE)
        pixels = mirrored_pixels(maps.cells_to_pixels(cells, STRIDE), images.shape[-1], is_mirrored)
        return KeypointEstimate(pixels, confidence, cells, heatmaps)

    def loss(
        self,
        estimate: KeypointEstimate,
        pixels: Float[Tensor, "batch joint 2"],
        is_valid: Bool[Tensor, "batch joint"],
        is_left: Bool[Tensor, " batch"],
    ) -> Float[Tensor, ""]:
        """Return 0.05 × L1 in px + 0.5 × cross-entropy of the heatmaps with bilinear targets.

        Args:
            estimate: What `forward` returned for these crops and sides.
            pixels: True joints (x, y) in the crops; anything where not valid.
            is_valid: Joints that count.
            is_left: As given to `forward`.
        """
        width_px = estimate.heatmaps.shape[-1] * STRIDE
        cells = maps.pixels_to_cells(mirrored_pixels(pixels, width_px, self._is_mirrored(is_left)), STRIDE)
        distance_px = maps.position_loss(estimate.pixels, pixels, is_valid)
        return POSITION_WEIGHT * distance_px + ENTROPY_WEIGHT * maps.cross_entropy(estimate.heatmaps, cells, is_valid)

    def _is_mirrored(self, is_left: Bool[Tensor, " batch"]) -> Bool[Tensor, " batch"]:
        return is_left if self.config.is_left_mirrored else torch.zeros_like(is_left)
