"""Unprojection and fusion in one kernel, on CUDA: the GPU's form of `fused_unprojection`, which says how it works.

A program takes some voxels and all channels through the views with a running softmax; nothing larger than the volume
is ever written. Going back, samples are taken again and gradients are added by atomics, so that their last bits depend
on the order. Voxels are projected in float32, those of `geometry.volumes` in float64: a voxel within some 1e-4 px of an
image's border may count as seen by one and not by the other.
"""

import inspect
from collections.abc import Callable
from typing import Any, Final

import torch
import triton
import triton.language as tl
from jaxtyping import Bool, Float
from torch import Tensor

from assemblyhands_core.geometry.volumes import MIN_DEPTH_MM

_VOXELS: Final = 32  # per program: 32 × 32 channels are 8 numbers per thread of four warps


def fused_unproject_features_cuda(
    features: Float[Tensor, "batch view channel height width"],
    P_pixel_from_world: Float[Tensor, "batch view 3 4"],
    points_world_mm: Float[Tensor, "batch x y z 3"],
    is_view_used: Bool[Tensor, "batch view"],
) -> Float[Tensor, "batch channel x y z"]:
    """Return what `geometry.volumes.unproject_features` returns, computed in float32, for tensors on a GPU.

    Features in channels-last order are read in place; the volume comes out in channels_last_3d order.
    """
    volume: Tensor = _FusedUnprojection.apply(features, P_pixel_from_world, points_world_mm, is_view_used)  # type: ignore[no-untyped-call]
    return volume


class _FusedUnprojection(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, P: Tensor, points: Tensor, used: Tensor) -> Tensor:
        ctx.save_for_backward(features, P, points, used)
        maps, *geometry = _prepared(features, P, points, used)
        fused = maps.new_empty(len(points), geometry[1].shape[1], maps.shape[-1])
        _fuse[_grid(fused)](maps, *geometry, fused, *_sizes(maps, fused))
        return fused.view(*points.shape[:4], -1).permute(0, 4, 1, 2, 3).to(features.dtype)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, None]:
        features, *others = ctx.saved_tensors
        maps, *geometry = _prepared(features, *others)
        upstream = gradients[0].permute(0, 2, 3, 4, 1).flatten(1, 3).float().contiguous()
        sums = torch.zeros_like(maps)
        _differentiate[_grid(upstream)](maps, *geometry, upstream, sums, *_sizes(maps, upstream))
        return sums.permute(0, 1, 4, 2, 3).to(features.dtype), None, None, None


def _prepared(features: Tensor, P: Tensor, points: Tensor, used: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return features (batch, view, height, width, channel), matrices, points (batch, point, 3) and used views."""
    maps = features.detach().float().permute(0, 1, 3, 4, 2).contiguous()
    return maps, P.float().contiguous(), points.flatten(1, 3).float().contiguous(), used.float().contiguous()


def _grid(volume: Tensor) -> tuple[int, int]:
    return triton.cdiv(volume.shape[1], _VOXELS), len(volume)


def _sizes(maps: Tensor, volume: Tensor) -> tuple[int | float, ...]:
    _, num_views, height, width, num_channels = maps.shape
    padded = max(16, triton.next_power_of_2(num_channels))
    return volume.shape[1], num_views, height, width, num_channels, MIN_DEPTH_MM, _VOXELS, padded


def _kernel(function: Callable[..., None]) -> Any:
    return triton.jit(inspect.unwrap(function))  # tests wrap functions in checks of types, which have no place in it


# fmt: off
@_kernel
def _locate(  # type: ignore[no-untyped-def]
    P, is_used, x, y, z, row, height, width, num_channels, min_depth_mm
):
    """Return who sees, the offset of the upper left cell, the steps to the right and down, and the place between."""
    M = P + row * 12
    depth = tl.load(M + 8) * x + tl.load(M + 9) * y + tl.load(M + 10) * z + tl.load(M + 11)
    seen = depth * tl.load(is_used + row) >= min_depth_mm  # 1 or 0: a view that is not used has no depth
    depth = tl.where(seen, depth, 1.0)
    u = (tl.load(M) * x + tl.load(M + 1) * y + tl.load(M + 2) * z + tl.load(M + 3)) / depth
    v = (tl.load(M + 4) * x + tl.load(M + 5) * y + tl.load(M + 6) * z + tl.load(M + 7)) / depth
    seen = seen & (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    u = tl.where(seen, tl.minimum(tl.maximum(u, 0.0), width - 1.0), 0.0)
    v = tl.where(seen, tl.minimum(tl.maximum(v, 0.0), height - 1.0), 0.0)
    left, top = u.to(tl.int32), v.to(tl.int32)
    first = ((row.to(tl.int64) * height + top) * width + left) * num_channels
    right = tl.where(left < width - 1, num_channels, 0)
    down = tl.where(top < height - 1, width * num_channels, 0)
    return seen, first, right, down, u - left, v - top


@_kernel
def _sample(  # type: ignore[no-untyped-def]
    features, mask, channels, first, right, down, a, b
):
    """Return what a view sees, (voxel, channel)."""
    upper_left = features + first[:, None] + channels[None, :]
    a, b, right, down = a[:, None], b[:, None], right[:, None], down[:, None]
    upper = (1 - a) * tl.load(upper_left, mask, 0.0) + a * tl.load(upper_left + right, mask, 0.0)
    lower = (1 - a) * tl.load(upper_left + down, mask, 0.0) + a * tl.load(upper_left + right + down, mask, 0.0)
    return (1 - b) * upper + b * lower


@_kernel
def _load_points(points, place, is_voxel):  # type: ignore[no-untyped-def]
    x = tl.load(points + place * 3, is_voxel, 0.0)
    y = tl.load(points + place * 3 + 1, is_voxel, 0.0)
    return x, y, tl.load(points + place * 3 + 2, is_voxel, 0.0)


@_kernel
def _running_softmax(  # type: ignore[no-untyped-def]
    features, P, is_used, x, y, z, item, num_views, height, width, num_channels, min_depth_mm,
    VOXELS: tl.constexpr, CHANNELS: tl.constexpr
):
    """Return the largest sample, the sum of exp(sample - largest) and the weighted mean, 0 where nobody sees."""
    channels = tl.arange(0, CHANNELS)
    peak = tl.full((VOXELS, CHANNELS), -1e30, tl.float32)
    total = tl.zeros((VOXELS, CHANNELS), tl.float32)
    mean = tl.zeros((VOXELS, CHANNELS), tl.float32)
    for view in range(num_views):
        row = item * num_views + view
        seen, first, right, down, a, b = _locate(
            P, is_used, x, y, z, row, height, width, num_channels, min_depth_mm
        )
        mask = seen[:, None] & (channels < num_channels)[None, :]
        samples = _sample(features, mask, channels, first, right, down, a, b)
        higher = tl.where(mask, tl.maximum(peak, samples), peak)
        weight = tl.exp(tl.where(mask, samples - higher, float("-inf")))
        shrink = tl.exp(peak - higher)
        total = total * shrink + weight
        mean = mean * shrink + weight * samples
        peak = higher
    total = tl.where(total > 0, total, 1.0)
    return peak, total, mean / total


@_kernel
def _fuse(  # type: ignore[no-untyped-def]
    features, P, points, is_used, fused, num_points, num_views, height, width, num_channels, min_depth_mm,
    VOXELS: tl.constexpr, CHANNELS: tl.constexpr
):
    """Write the fused features of some voxels of one item."""
    item = tl.program_id(1)
    voxels = tl.program_id(0) * VOXELS + tl.arange(0, VOXELS)
    place = item.to(tl.int64) * num_points + voxels
    x, y, z = _load_points(points, place, voxels < num_points)
    _peak, _total, mean = _running_softmax(
        features, P, is_used, x, y, z, item, num_views, height, width, num_channels, min_depth_mm, VOXELS, CHANNELS
    )
    channels = tl.arange(0, CHANNELS)
    is_real = (voxels < num_points)[:, None] & (channels < num_channels)[None, :]
    tl.store(fused + place[:, None] * num_channels + channels[None, :], mean, is_real)


@_kernel
def _differentiate(  # type: ignore[no-untyped-def]
    features, P, points, is_used, upstream, sums, num_points, num_views, height, width, num_channels, min_depth_mm,
    VOXELS: tl.constexpr, CHANNELS: tl.constexpr
):
    """Add what some voxels of one item contribute to the gradient of its features."""
    item = tl.program_id(1)
    voxels = tl.program_id(0) * VOXELS + tl.arange(0, VOXELS)
    place = item.to(tl.int64) * num_points + voxels
    x, y, z = _load_points(points, place, voxels < num_points)
    peak, total, mean = _running_softmax(
        features, P, is_used, x, y, z, item, num_views, height, width, num_channels, min_depth_mm, VOXELS, CHANNELS
    )
    channels = tl.arange(0, CHANNELS)
    is_real = (voxels < num_points)[:, None] & (channels < num_channels)[None, :]
    above = tl.load(upstream + place[:, None] * num_channels + channels[None, :], is_real, 0.0)
    for view in range(num_views):
        row = item * num_views + view
        seen, first, right, down, a, b = _locate(
            P, is_used, x, y, z, row, height, width, num_channels, min_depth_mm
        )
        mask = seen[:, None] & is_real
        samples = _sample(features, mask, channels, first, right, down, a, b)
        weight = tl.exp(tl.where(mask, samples - peak, float("-inf"))) / total
        gradient = above * weight * (1 + samples - mean)
        target = sums + first[:, None] + channels[None, :]
        a, b, right, down = a[:, None], b[:, None], right[:, None], down[:, None]
        tl.atomic_add(target, (1 - a) * (1 - b) * gradient, mask)
        tl.atomic_add(target + right, a * (1 - b) * gradient, mask)
        tl.atomic_add(target + down, (1 - a) * b * gradient, mask)
        tl.atomic_add(target + right + down, a * b * gradient, mask)
# fmt: on
