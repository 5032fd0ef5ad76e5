"""Heatmaps of joints in 2D and 3D: reading positions out of them, targets, losses.

A heatmap here is an array of logits; its softmax over all cells is the probability of the joint's cell. Positions are
in *cells*, integers at cell centres, and the order of their coordinates is the order of the heatmap's axes: for images
(y, x), for volumes (x, y, z). `cells_to_…` and `…_to_cells` change to pixels (x, y) and mm.
"""

import itertools
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


class Joints(NamedTuple):
    """Positions of joints in cells, and the share of probability near them, in [0, 1]."""

    cells: Float[Tensor, "batch joint dim"]
    confidence: Float[Tensor, "batch joint"]


def soft_argmax(
    heatmaps: Float[Tensor, "batch joint *cell"], temperature: float = 1.0
) -> Float[Tensor, "batch joint dim"]:
    """Return the mean cell under the softmax of the heatmap, in cells, in float32 at least.

    Source: Iskakov et al., Learnable Triangulation of Human Pose (ICCV 2019), Sec. 3; Sun et al. (ECCV 2018).
    """
    return _mean_cell(_probabilities(heatmaps, temperature))


def argmax(heatmaps: Float[Tensor, "batch joint *cell"]) -> Float[Tensor, "batch joint dim"]:
    """Return the cell of the highest value, the first one of several; no gradient flows."""
    places = torch.unravel_index(heatmaps.flatten(2).argmax(dim=-1), heatmaps.shape[2:])
    return torch.stack(places, dim=-1).to(torch.float32)


def read_joints(heatmaps: Float[Tensor, "batch joint *cell"], radius_cells: float, temperature: float = 1.0) -> Joints:
    """Return soft-argmax and confidence: the probability of the cells within a radius of that position.

    A sharp peak gives 1, two rival peaks or a flat map little. No gradient flows into the confidence.
    """
    probabilities = _probabilities(heatmaps, temperature)
    cells = _mean_cell(probabilities)
    return Joints(cells, _mass_near(probabilities.detach(), cells.detach(), radius_cells))


def cells_to_world_mm(
    cells: Float[Tensor, "batch joint 3"], root_world_mm: Float[Tensor, "batch 3"], side_mm: float, num_voxels: int
) -> Float[Tensor, "batch joint 3"]:
    """Return where voxel positions of `geometry.volumes.cube_points_world_mm` lie in the world."""
    return root_world_mm[:, None] + cells_to_offset_mm(cells, side_mm, num_voxels)


def world_mm_to_cells(
    points_world_mm: Float[Tensor, "batch joint 3"],
    root_world_mm: Float[Tensor, "batch 3"],
    side_mm: float,
    num_voxels: int,
) -> Float[Tensor, "batch joint 3"]:
    """Return the voxel positions of points in the world: the inverse of `cells_to_world_mm`."""
    return offset_mm_to_cells(points_world_mm - root_world_mm[:, None], side_mm, num_voxels)


def cells_to_offset_mm(cells: Float[Tensor, "*axis"], side_mm: float, num_cells: int) -> Float[Tensor, "*axis"]:
    """Return how far from the middle of a range of so many cells positions lie, along any axis."""
    return (cells + 0.5) * (side_mm / num_cells) - side_mm / 2


def offset_mm_to_cells(offset_mm: Float[Tensor, "*axis"], side_mm: float, num_cells: int) -> Float[Tensor, "*axis"]:
    """Return the cells of offsets from the middle of a range: the inverse of `cells_to_offset_mm`."""
    return (offset_mm + side_mm / 2) * (num_cells / side_mm) - 0.5


def cells_to_pixels(cells: Float[Tensor, "batch joint 2"], stride: int) -> Float[Tensor, "batch joint 2"]:
    """Return the image pixels (x, y) of cells (y, x) of a heatmap that is smaller by the stride."""
    return (cells.flip(-1) + 0.5) * stride - 0.5


def pixels_to_cells(pixels: Float[Tensor, "batch joint 2"], stride: int) -> Float[Tensor, "batch joint 2"]:
    """Return the cells (y, x) of image pixels (x, y): the inverse of `cells_to_pixels`."""
    return ((pixels + 0.5) / stride - 0.5).flip(-1)


def corner_weights(
    cells: Float[Tensor, "batch joint dim"], shape: tuple[int, ...]
) -> tuple[Int[Tensor, "batch joint corner"], Float[Tensor, "batch joint corner"]]:
    """Return the flat indices of the cells around each position and its bilinear or trilinear weights for them.

    The weighted mean of these cells is the position, so the soft-argmax of this target is free of rounding. Positions
    outside are moved to the border.
    """
    limits = torch.tensor(shape, device=cells.device)
    inside = torch.minimum(cells.clamp(min=0), (limits - 1).to(cells.dtype))
    lower = inside.floor().long().minimum((limits - 2).clamp(min=0))
    share = inside - lower
    indices, weights = [], []
    for steps in itertools.product((0, 1), repeat=len(shape)):
        step = torch.tensor(steps, device=cells.device)
        corner = (lower + step).minimum(limits - 1)
        indices.append(_flat_index(corner, shape))
        weights.append(torch.where(step.bool(), share, 1 - share).prod(dim=-1))
    return torch.stack(indices, dim=-1), torch.stack(weights, dim=-1)


def target_heatmaps(
    cells: Float[Tensor, "batch joint dim"], shape: tuple[int, ...]
) -> Float[Tensor, "batch joint *cell"]:
    """Return the probabilities that a heatmap should have, `corner_weights` spread out over all cells."""
    indices, weights = corner_weights(cells, shape)
    flat = cells.new_zeros(*cells.shape[:2], int(torch.tensor(shape).prod()))
    return flat.scatter_add(-1, indices, weights).view(*cells.shape[:2], *shape)


def cross_entropy(
    heatmaps: Float[Tensor, "batch joint *cell"],
    cells: Float[Tensor, "batch joint dim"],
    is_valid: Bool[Tensor, "batch joint"],
) -> Float[Tensor, ""]:
    """Return the mean cross-entropy against `target_heatmaps` over valid joints that lie on the map; 0 without any."""
    shape = tuple(heatmaps.shape[2:])
    limits = torch.tensor(shape, device=cells.device)
    is_counted = is_valid & ((cells >= -0.5) & (cells <= limits - 0.5)).all(dim=-1)
    indices, weights = corner_weights(torch.where(is_counted[..., None], cells, 0), shape)  # NaN has no cell
    logits = _precise(heatmaps).flatten(2)
    entropies = logits.logsumexp(dim=-1) - (logits.gather(-1, indices) * weights).sum(dim=-1)
    return _masked_mean(entropies, is_counted)


def position_loss(
    predicted: Float[Tensor, "batch joint dim"],
    true: Float[Tensor, "batch joint dim"],
    is_valid: Bool[Tensor, "batch joint"],
) -> Float[Tensor, ""]:
    """Return the mean L1 distance of valid joints per coordinate, in the unit given (mm or px); 0 without any."""
    return _masked_mean((predicted - true).abs().mean(dim=-1), is_valid)


def _masked_mean(values: Float[Tensor, "batch joint"], is_counted: Bool[Tensor, "batch joint"]) -> Float[Tensor, ""]:
    # NaN stands where nothing is valid: chosen away before the sum, or its gradient would be NaN as well.
    return torch.where(is_counted, values, 0).sum() / is_counted.sum().clamp(min=1)


def _probabilities(
    heatmaps: Float[Tensor, "batch joint *cell"], temperature: float
) -> Float[Tensor, "batch joint *cell"]:
    logits = _precise(heatmaps).flatten(2)
    scaled = logits if temperature == 1 else logits / temperature  # a pass over all cells saved, and one back
    flat = scaled.softmax(dim=-1)
    return flat.view(-1, *heatmaps.shape[1:])  # -1: an exported network takes batches of any size


def _precise(heatmaps: Float[Tensor, "batch joint *cell"]) -> Float[Tensor, "batch joint *cell"]:
    return heatmaps if heatmaps.dtype == torch.float64 else heatmaps.float()  # bfloat16 cannot tell 100 cells apart


def _mean_cell(probabilities: Float[Tensor, "batch joint *cell"]) -> Float[Tensor, "batch joint dim"]:
    means = []
    for axis in range(2, probabilities.ndim):
        others = [other for other in range(2, probabilities.ndim) if other != axis]
        # No matrix product: mixed precision would do it in bfloat16, in steps of an eighth of a cell and more.
        means.append((probabilities.sum(dim=others) * _steps(probabilities, axis)).sum(dim=-1))
    return torch.stack(means, dim=-1)


def _mass_near(
    probabilities: Float[Tensor, "batch joint *cell"], cells: Float[Tensor, "batch joint dim"], radius_cells: float
) -> Float[Tensor, "batch joint"]:
    num_axes = cells.shape[-1]
    squared = probabilities.new_zeros(())
    for axis in range(num_axes):
        distance = _steps(probabilities, 2 + axis) - cells[..., axis, None]
        around = [1] * num_axes
        around[axis] = probabilities.shape[2 + axis]
        squared = squared + distance.square().view(-1, cells.shape[1], *around)
    return (probabilities * (squared <= radius_cells**2)).flatten(2).sum(dim=-1)


def _steps(like: Float[Tensor, "batch joint *cell"], axis: int) -> Float[Tensor, " cell"]:
    return torch.arange(like.shape[axis], dtype=like.dtype, device=like.device)


def _flat_index(corner: Int[Tensor, "batch joint dim"], shape: tuple[int, ...]) -> Int[Tensor, "batch joint"]:
    index = torch.zeros_like(corner[..., 0])
    for axis, size in enumerate(shape):
        index = index * size + corner[..., axis]
    return index
