"""SVEgoNet: a crop of one egocentric picture in, the joints of both hands in 2.5D and whose hands they are out.

Source: paper, Sec. 4 ("Single-view baseline"): 2.5D heatmaps, that is position in the picture and depth relative to the
wrist, ResNet-50, and a branch that tells left, right or both hands. A crop is made around one hand; the other one's
joints are learnt wherever they lie in it, too.
"""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from assemblyhands_core.data.ego_boxes import IDENTITIES
from assemblyhands_core.hands.joints import NUM_BOTH
from assemblyhands_core.models import heatmaps as maps
from assemblyhands_core.models.encoder import STRIDE, ImageEncoder

POSITION_WEIGHT: Final = 0.05  # per px
DEPTH_WEIGHT: Final = 0.05  # per mm
ENTROPY_WEIGHT: Final = 0.2
IDENTITY_WEIGHT: Final = 0.2

Decoding = Literal["soft_argmax", "argmax"]


@dataclass(frozen=True)
class SVEgoNetConfig:
    """What determines the network's shape and reading.

    Attributes:
        backbone: timm name of the image encoder.
        num_levels: Levels of the backbone that are used.
        num_channels: Channels of the feature maps.
        image_size_px: Side of the square crops.
        num_depths: Cells of the heatmaps along the depth.
        depth_range_mm: Depth that the heatmaps span, the wrist's in the middle.
        confidence_radius_cells: Confidence is the probability within this distance of the joint.
    """

    backbone: str
    num_levels: int
    num_channels: int
    image_size_px: int
    num_depths: int
    depth_range_mm: float = 400.0
    confidence_radius_cells: float = 2.5


SMALL: Final = SVEgoNetConfig("tf_efficientnet_lite0", 3, 64, image_size_px=128, num_depths=16)
BASE: Final = SVEgoNetConfig("resnet50", 4, 256, image_size_px=256, num_depths=64)


class EgoEstimate(NamedTuple):
    """What the network says about each crop, right hand first.

    Attributes:
        pixels: Joints (x, y) in the crop, integers at pixel centres.
        depth_mm: Of each joint beyond its own wrist, along the optical axis.
        confidence: Probability near each, in [0, 1]; NaN in training, which does not need it.
        identity: Logits of `IDENTITIES`.
        cells: The joints (depth, y, x) in cells of the heatmaps.
        heatmaps: Logits.
    """

    pixels: Float[Tensor, "batch joint=42 2"]
    depth_mm: Float[Tensor, "batch joint=42"]
    confidence: Float[Tensor, "batch joint=42"]
    identity: Float[Tensor, "batch identity=3"]
    cells: Float[Tensor, "batch joint=42 3"]
    heatmaps: Float[Tensor, "batch joint=42 depth height width"]


class SVEgoNet(nn.Module):
    """The egocentric network.

    Args:
        config: `SMALL` for laptops, `BASE` for the paper's size, or one's own.
    """

    def __init__(self, config: SVEgoNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.backbone, config.num_channels, config.num_levels)
        self.head = nn.Sequential(
            nn.BatchNorm2d(config.num_channels),
            nn.ReLU(inplace=True),
            nn.Conv2d(config.num_channels, NUM_BOTH * config.num_depths, 1),
        )
        self.identity = nn.Sequential(
            nn.Linear(2 * config.num_channels, config.num_channels),
            nn.ReLU(inplace=True),
            nn.Linear(config.num_channels, len(IDENTITIES)),
        )

    def forward(self, images: Float[Tensor, "batch 3 height width"], decoding: Decoding = "soft_argmax") -> EgoEstimate:
        """Find the joints in crops.

        Args:
            images: In [0, 1]; a grey picture three times.
            decoding: How heatmaps are read; through `argmax` (the paper's) no gradient flows.
        """
        features = self.encoder(images)
        # One copy here instead of one for each of its readers: the head leaves its channels last.
        volumes = self.head(features).contiguous().unflatten(1, (NUM_BOTH, self.config.num_depths))
        if self.training:
            cells, confidence = maps.soft_argmax(volumes), volumes.new_full(volumes.shape[:2], torch.nan)
        else:
            cells, confidence = maps.read_joints(volumes, self.config.confidence_radius_cells)
        if decoding == "argmax":
            cells = maps.argmax(volumes)
        pooled = torch.cat((features.mean(dim=(-2, -1)), features.amax(dim=(-2, -1))), dim=-1)
        return EgoEstimate(
            pixels=maps.cells_to_pixels(cells[..., 1:], STRIDE),
            depth_mm=self._depth_mm(cells[..., 0]),
            confidence=confidence,
            identity=self.identity(pooled.float()),
            cells=cells,
            heatmaps=volumes,
        )

    def loss(
        self,
        estimate: EgoEstimate,
        pixels: Float[Tensor, "batch joint=42 2"],
        depth_mm: Float[Tensor, "batch joint=42"],
        is_valid: Bool[Tensor, "batch joint=42"],
        identity: Int[Tensor, " batch"],
    ) -> Float[Tensor, ""]:
        """Return L1 in px and mm (0.05 each) + 0.2 × cross-entropy of the heatmaps + 0.2 × that of the identity.

        Args:
            estimate: What `forward` returned for these crops.
            pixels: True joints (x, y) in the crops; anything where not valid.
            depth_mm: Of each joint beyond its own wrist.
            is_valid: Joints that count.
            identity: Index into `IDENTITIES`.
        """
        cells = torch.cat((self._depth_cells(depth_mm)[..., None], maps.pixels_to_cells(pixels, STRIDE)), dim=-1)
        place_px = maps.position_loss(estimate.pixels, pixels, is_valid)
        depth = maps.position_loss(estimate.depth_mm[..., None], depth_mm[..., None], is_valid)
        entropy = maps.cross_entropy(estimate.heatmaps, cells, is_valid)
        position = POSITION_WEIGHT * place_px + DEPTH_WEIGHT * depth + ENTROPY_WEIGHT * entropy
        return position + IDENTITY_WEIGHT * F.cross_entropy(estimate.identity, identity)

    def _depth_mm(self, cells: Float[Tensor, "batch joint"]) -> Float[Tensor, "batch joint"]:
        return maps.cells_to_offset_mm(cells, self.config.depth_range_mm, self.config.num_depths)

    def _depth_cells(self, depth_mm: Float[Tensor, "batch joint"]) -> Float[Tensor, "batch joint"]:
        return maps.offset_mm_to_cells(depth_mm, self.config.depth_range_mm, self.config.num_depths)
