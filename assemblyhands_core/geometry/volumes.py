"""Volumes around a hand, and what several views see in them: the readable form, in plain torch.

A *cube* of side s has n³ voxels; voxel (i, j, k) is centred at root + ((i, j, k) + 1/2) s/n - s/2, axes along x, y, z
of the world. `models.unprojection` computes the same as `unproject_features` without its large intermediate arrays.
"""

from typing import Final, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

# "pixel_centres": a voxel is seen by a view where it falls on the map, [-1/2, W - 1/2], in front of the camera.
# "reference" is the rule of a published program, kept for comparing numbers with it: it samples at u (W - 1)/W, takes
# what lies outside for zero and lets views that see nothing vote with that zero.
Sampling = Literal["pixel_centres", "reference"]

MIN_DEPTH_MM: Final = 1.0


def cube_points_world_mm(
    root_world_mm: Float[Tensor, "batch 3"], side_mm: float, num_voxels: int
) -> Float[Tensor, "batch num_voxels num_voxels num_voxels 3"]:
    """Return the centres of the voxels of cubes around roots.

    Args:
        root_world_mm: Centre of each cube, the middle MCP in the paper (Sec. 3.1).
        side_mm: Side of the cube, 300 in the paper.
        num_voxels: Voxels along each side.
    """
    steps = torch.arange(num_voxels, dtype=root_world_mm.dtype, device=root_world_mm.device)
    offsets_mm = (steps + 0.5) * (side_mm / num_voxels) - side_mm / 2
    grid_mm = torch.stack(torch.meshgrid(offsets_mm, offsets_mm, offsets_mm, indexing="ij"), dim=-1)
    return root_world_mm[:, None, None, None, :] + grid_mm


def unproject_features(
    features: Float[Tensor, "batch view channel height width"],
    P_pixel_from_world: Float[Tensor, "batch view 3 4"],
    points_world_mm: Float[Tensor, "batch x y z 3"],
    is_view_used: Bool[Tensor, "batch view"] | None = None,
    sampling: Sampling = "pixel_centres",
) -> Float[Tensor, "batch channel x y z"]:
    """Average over the views what each sees at the points, weighted by softmax, channel by channel.

    Σᵥ softmaxᵥ(sᵥ) sᵥ over the views v that see the point, sᵥ sampled bilinearly; 0 where no view does. Pixels within
    half a pixel of the border take the border's value. Gradients flow into the features only.

    Args:
        features: Feature maps.
        P_pixel_from_world: K [R | t] into pixels of the *feature map*, integers at pixel centres, world in mm.
        points_world_mm: Points, usually the voxels of `cube_points_world_mm`.
        is_view_used: Views to leave out are false.
        sampling: Anything but "pixel_centres" is for comparisons with other programs.

    Source: the paper, Sec. 3.1; Iskakov et al., Learnable Triangulation of Human Pose (ICCV 2019), Sec. 3.2.
    """
    batch, _, channels, *_ = features.shape
    points = points_world_mm.flatten(1, 3)
    views = zip(features.unbind(1), P_pixel_from_world.unbind(1), strict=True)
    looks = (_look(maps, matrices, points, sampling) for maps, matrices in views)
    samples, votes = zip(*looks, strict=True)
    is_voting = torch.stack(votes, dim=1)
    if is_view_used is not None:
        is_voting = is_voting & is_view_used[:, :, None]
    fused = _softmax_mean(torch.stack(samples, dim=1), is_voting[:, :, None])
    return fused.view(batch, channels, *points_world_mm.shape[1:4])


def _project(
    P_pixel_from_world: Float[Tensor, "batch 3 4"], points_world_mm: Float[Tensor, "batch point 3"]
) -> tuple[Float[Tensor, "batch point 2"], Float[Tensor, "batch point"]]:
    """Return pixels and depths, in float64: half a pixel decides whether a view sees a point.

    Points nearer than `MIN_DEPTH_MM` or behind the camera have a depth below it and a meaningless finite pixel.
    """
    P, points = P_pixel_from_world.double(), points_world_mm.double()
    x_w, y_w, depth = (points @ P[..., :3].mT + P[..., None, :, 3]).unbind(-1)
    divisor = depth.clamp(min=MIN_DEPTH_MM)
    return torch.stack((x_w / divisor, y_w / divisor), dim=-1), depth


def _look(
    features: Float[Tensor, "batch channel height width"],
    P_pixel_from_world: Float[Tensor, "batch 3 4"],
    points_world_mm: Float[Tensor, "batch point 3"],
    sampling: Sampling,
) -> tuple[Float[Tensor, "batch channel point"], Bool[Tensor, "batch point"]]:
    """Return what one view sees at the points, and where it has a vote."""
    pixels, depth = _project(P_pixel_from_world, points_world_mm)
    size = torch.tensor(features.shape[:1:-1], dtype=pixels.dtype, device=pixels.device)
    in_front = depth >= MIN_DEPTH_MM
    if sampling == "reference":
        seen = _sample(features, 2 * (pixels / size) - 1, "zeros", align_corners=True)
        return seen * (depth > 0)[:, None], torch.ones_like(in_front)
    is_inside = ((pixels >= -0.5) & (pixels <= size - 0.5)).all(dim=-1)
    return _sample(features, (2 * pixels + 1) / size - 1, "border", align_corners=False), in_front & is_inside


def _sample(
    features: Float[Tensor, "batch channel height width"],
    positions: Float[Tensor, "batch point 2"],
    padding: Literal["zeros", "border"],
    align_corners: bool,
) -> Float[Tensor, "batch channel point"]:
    wide = torch.promote_types(features.dtype, torch.float32)  # bfloat16 would put points a sixteenth of a cell off
    grid = positions.to(wide)[:, None]
    found = F.grid_sample(features.to(wide), grid, padding_mode=padding, align_corners=align_corners)[:, :, 0]
    return found.to(features.dtype)


def _softmax_mean(
    samples: Float[Tensor, "batch view channel point"], is_voting: Bool[Tensor, "batch view 1 point"]
) -> Float[Tensor, "batch channel point"]:
    weights = torch.softmax(samples.masked_fill(~is_voting, -torch.inf), dim=1)
    return (weights.masked_fill(~is_voting, 0) * samples).sum(dim=1)
