"""MVExoNet: crops of one hand from several calibrated views in, its 21 joints in the world out.

Source: paper, Sec. 3.1 and supplement B–C. Encoder per view, one cube of 300 mm around the middle MCP, softmax over the
views that see each voxel, V2V, soft-argmax.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from assemblyhands_core.geometry.volumes import cube_points_world_mm
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.models import heatmaps as maps
from assemblyhands_core.models.encoder import STRIDE, ImageEncoder
from assemblyhands_core.models.mirroring import mirrored_images, mirrored_matrices, mirrored_points
from assemblyhands_core.models.unprojection import Form, fuse_views, scaled_matrices
from assemblyhands_core.models.v2v import V2VSize, build_v2v


@dataclass(frozen=True)
class MVExoNetConfig:
    """What determines the network's shape and reading.

    Attributes:
        backbone: timm name of the image encoder.
        num_levels: Levels of the backbone that are used; 3 ends at stride 16.
        num_channels: Channels of feature maps and volume.
        image_size_px: Side of the square crops.
        num_voxels: Voxels along each side of the cube.
        cube_side_mm: Side of the cube.
        v2v: Size of the 3D network.
        is_left_mirrored: Whether left hands are mirrored into right ones, or learnt as they are.
        confidence_radius_mm: Confidence is the probability within this distance of the joint.
    """

    backbone: str
    num_levels: int
    num_channels: int
    image_size_px: int
    num_voxels: int
    v2v: V2VSize
    cube_side_mm: float = 300.0
    is_left_mirrored: bool = True
    confidence_radius_mm: float = 20.0


SMALL: Final = MVExoNetConfig("tf_efficientnet_lite0", 3, 32, image_size_px=128, num_voxels=32, v2v="slim")
BASE: Final = MVExoNetConfig("tf_efficientnet_lite0", 4, 32, image_size_px=256, num_voxels=64, v2v="reference")

POSITION_WEIGHT: Final = 0.05  # per mm
ENTROPY_WEIGHT: Final = 0.2


class HandEstimate(NamedTuple):
    """What the network says about each hand.

    Attributes:
        joints_world_mm: Joints in our order.
        confidence: Probability within `confidence_radius_mm` of each, in [0, 1].
        cells: The joints in voxels of the cube, which is mirrored for left hands where the config says so.
        heatmaps: Logits, in the same cube.
    """

    joints_world_mm: Float[Tensor, "batch joint 3"]
    confidence: Float[Tensor, "batch joint"]
    cells: Float[Tensor, "batch joint 3"]
    heatmaps: Float[Tensor, "batch joint x y z"]


class MVExoNet(nn.Module):
    """The annotation network; a batch holds hands of any side and instant.

    Args:
        config: `SMALL` for laptops, `BASE` for the paper's size, or one's own.
        form: How views are fused; all forms give the same numbers.
    """

    def __init__(self, config: MVExoNetConfig, form: Form = "auto") -> None:
        super().__init__()
        self.config, self.form = config, form
        self.encoder = ImageEncoder(config.backbone, config.num_channels, config.num_levels)
        self.v2v = build_v2v(config.v2v, config.num_channels, NUM_JOINTS)

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        P_pixel_from_world: Float[Tensor, "batch view 3 4"],
        is_view_used: Bool[Tensor, "batch view"],
        root_world_mm: Float[Tensor, "batch 3"],
        is_left: Bool[Tensor, " batch"],
    ) -> HandEstimate:
        """Estimate the joints of hands.

        Args:
            images: Rectified square crops, RGB in [0, 1]; anything finite where a view is not used.
            P_pixel_from_world: K [R | t] of the crops, integers at pixel centres, world in mm.
            is_view_used: False for views without a crop.
            root_world_mm: Centre of the cube: the middle MCP as far as it is known.
            is_left: Whether the hand is a left one.
        """
        is_mirrored = self._is_mirrored(is_left)
        images = mirrored_images(images, is_mirrored)
        matrices = mirrored_matrices(P_pixel_from_world, images.shape[-1], is_mirrored)
        root = mirrored_points(root_world_mm, is_mirrored)
        points = cube_points_world_mm(root, self.config.cube_side_mm, self.config.num_voxels)
        features = self._encode(images, is_view_used)
        volume = fuse_views(features, scaled_matrices(matrices, STRIDE), points, is_view_used, self.form)
        return self._read(self.v2v(volume), root, is_mirrored)

    def loss(
        self,
        estimate: HandEstimate,
        joints_world_mm: Float[Tensor, "batch joint 3"],
        is_valid: Bool[Tensor, "batch joint"],
        root_world_mm: Float[Tensor, "batch 3"],
        is_left: Bool[Tensor, " batch"],
    ) -> Float[Tensor, ""]:
        """Return 0.05 × L1 in mm + 0.2 × cross-entropy of the heatmaps with trilinear targets.

        Args:
            estimate: What `forward` returned for these roots and sides.
            joints_world_mm: True joints; anything where not valid.
            is_valid: Joints that count.
            root_world_mm: As given to `forward`.
            is_left: As given to `forward`.
        """
        is_mirrored, config = self._is_mirrored(is_left), self.config
        true_mm, root = mirrored_points(joints_world_mm, is_mirrored), mirrored_points(root_world_mm, is_mirrored)
        cells = maps.world_mm_to_cells(true_mm, root, config.cube_side_mm, config.num_voxels)
        distance_mm = maps.position_loss(estimate.joints_world_mm, joints_world_mm, is_valid)
        return POSITION_WEIGHT * distance_mm + ENTROPY_WEIGHT * maps.cross_entropy(estimate.heatmaps, cells, is_valid)

    def _is_mirrored(self, is_left: Bool[Tensor, " batch"]) -> Bool[Tensor, " batch"]:
        return is_left if self.config.is_left_mirrored else torch.zeros_like(is_left)

    def _encode(
        self, images: Float[Tensor, "batch view 3 height width"], is_view_used: Bool[Tensor, "batch view"]
    ) -> Float[Tensor, "batch view channel feature_height feature_width"]:
        """Encode used views only: the others cost nothing and do not enter the batch norms' statistics."""
        chosen = is_view_used.flatten()
        if not chosen.any():
            height, width = (size // STRIDE for size in images.shape[-2:])
            return images.new_zeros(*is_view_used.shape, self.config.num_channels, height, width)
        encoded: Tensor = self.encoder(images.flatten(0, 1)[chosen])
        if not chosen.all():
            places = chosen.nonzero()[:, 0]
            blank = encoded.new_zeros(len(chosen), *encoded.shape[1:])
            encoded = blank.contiguous(memory_format=torch.channels_last).index_copy(0, places, encoded)
        return encoded.view(*is_view_used.shape, *encoded.shape[1:])

    def _read(
        self,
        heatmaps: Float[Tensor, "batch joint x y z"],
        root_world_mm: Float[Tensor, "batch 3"],
        is_mirrored: Bool[Tensor, " batch"],
    ) -> HandEstimate:
        side_mm, num_voxels = self.config.cube_side_mm, self.config.num_voxels
        cells, confidence = maps.read_joints(heatmaps, self.config.confidence_radius_mm * num_voxels / side_mm)
        joints_mm = maps.cells_to_world_mm(cells, root_world_mm, side_mm, num_voxels)
        return HandEstimate(mirrored_points(joints_mm, is_mirrored), confidence, cells, heatmaps)
