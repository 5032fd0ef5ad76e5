"""Unprojection and fusion in one loop over voxels, on CPU: never an array of view × channel × voxel.

A voxel's samples (view × channel, a few kB) stay in the processor's cache: they are taken, weighed by softmax and
averaged before the next voxel's turn. Going back, they are taken again instead of being remembered. With samples s,
weights w = softmax(s) and mean z = Σ w s the derivative is ∂z/∂sᵥ = wᵥ (1 + sᵥ - z). Compiled by numba, so no compiler
is needed; results do not depend on the number of threads. Values and gradients are those of
`geometry.volumes.unproject_features`, against which tests hold them.
"""

import inspect
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, ParamSpec, TypeVar, cast

import numba
import numpy as np
import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor

from assemblyhands_core.geometry.volumes import MIN_DEPTH_MM

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

_FORWARD_CHUNKS: Final = 64  # of voxels, over all items of a batch: enough for any number of cores
_BACKWARD_CHUNKS: Final = 8  # fewer, as each sums gradients of its own
_MIN_POINTS: Final = 256  # below, handing a part to a thread costs more than it gains


def _compiled(inline: bool) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Compile; sums may be reordered to use vector units, but NaN stays NaN, so that divergence shows.

    What a loop calls is to be inlined: only then does the compiler see that scratch arrays never overlap (3 ×). The
    machine code is kept until this file changes; a new `MIN_DEPTH_MM` alone does not renew it.
    """

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        plain = inspect.unwrap(function)  # tests wrap functions in checks of types, which numba cannot compile
        options = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}}
        return cast(Callable[Arguments, Result], numba.njit(plain, inline="always" if inline else "never", **options))

    return decorate


def fused_unproject_features(
    features: Float[Tensor, "batch view channel height width"],
    P_pixel_from_world: Float[Tensor, "batch view 3 4"],
    points_world_mm: Float[Tensor, "batch x y z 3"],
    is_view_used: Bool[Tensor, "batch view"],
) -> Float[Tensor, "batch channel x y z"]:
    """Return what `geometry.volumes.unproject_features` returns, for tensors on the CPU.

    Features in channels-last order are read in place; the volume comes out in channels_last_3d order. Computation is in
    float64 for float64 features and in float32 otherwise; where voxels fall is found in float64.
    """
    volume: Tensor = _FusedUnprojection.apply(features, P_pixel_from_world, points_world_mm, is_view_used)  # type: ignore[no-untyped-call]
    return volume


class _FusedUnprojection(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, P: Tensor, points: Tensor, used: Tensor) -> Tensor:
        ctx.save_for_backward(features, P, points, used)
        maps, matrices, points_mm, is_used = _arrays(features, P, points, used)
        fused = np.empty((*points_mm.shape[:2], maps.shape[-1]), maps.dtype)

        def fuse(item: int, _: int, part: slice) -> None:
            _fuse(maps[item], matrices[item], points_mm[item, part], is_used[item], fused[item, part])

        _in_threads(fuse, _parts(len(fused), fused.shape[1], _FORWARD_CHUNKS))
        volume = torch.from_numpy(fused).view(*points.shape[:4], -1).permute(0, 4, 1, 2, 3)
        return volume.to(features.dtype)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None, None]:
        features, P, points, used = ctx.saved_tensors
        maps, matrices, points_mm, is_used = _arrays(features, P, points, used)
        upstream = _as_array(gradients[0].permute(0, 2, 3, 4, 1).flatten(1, 3))
        parts = _parts(len(upstream), upstream.shape[1], _BACKWARD_CHUNKS)
        sums = np.zeros((len(maps), len(parts) // len(maps), *maps.shape[1:]), maps.dtype)

        def differentiate(item: int, chunk: int, part: slice) -> None:
            sources = maps[item], matrices[item], points_mm[item, part], is_used[item], upstream[item, part]
            _differentiate(*sources, sums[item, chunk])

        _in_threads(differentiate, parts)
        gradient = torch.from_numpy(sums).sum(dim=1)
        return gradient.permute(0, 1, 4, 2, 3).to(features.dtype), None, None, None


def _parts(batch: int, num_points: int, num_parts: int) -> list[tuple[int, int, slice]]:
    """Return item, chunk and points of about so many parts; how many threads there are does not enter."""
    chunks = max(1, min(num_parts // batch, num_points // _MIN_POINTS))
    size = -(-num_points // chunks)
    return [(item, chunk, slice(chunk * size, (chunk + 1) * size)) for item in range(batch) for chunk in range(chunks)]


def _in_threads(work: Callable[[int, int, slice], None], parts: list[tuple[int, int, slice]]) -> None:
    """Work on parts in as many threads as torch has.

    These are Python's threads and not numba's parallel loops: those bring a second OpenMP beside torch's, after which
    every small operation of torch was seen to take a hundred times as long on a machine with other work.
    """
    with ThreadPoolExecutor(torch.get_num_threads()) as threads:
        for done in [threads.submit(work, *part) for part in parts]:
            done.result()


def _arrays(
    features: Tensor, P: Tensor, points: Tensor, used: Tensor
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return features (batch, view, height, width, channel), matrices, points (batch, point, 3) and used views."""
    maps = _as_array(features.permute(0, 1, 3, 4, 2))
    return maps, P.detach().double().contiguous().numpy(), _as_array(points.flatten(1, 3)), used.contiguous().numpy()


def _as_array(tensor: Tensor) -> np.ndarray:
    dtype = torch.float64 if tensor.dtype == torch.float64 else torch.float32
    return tensor.detach().to(dtype).contiguous().numpy()


@_compiled(inline=True)
def _sample_views(
    features: Float[np.ndarray, "view height width channel"],
    P: Float[np.ndarray, "view 3 4"],
    is_used: Bool[np.ndarray, " view"],
    point_mm: Float[np.ndarray, "3"],
    samples: Float[np.ndarray, "view channel"],
    cells: Int64[np.ndarray, "view 5"],
    shares: Float[np.ndarray, "view 4"],
) -> int:
    """Fill in what the views that see the point see, and from which cells; return how many they are."""
    num_views, height, width, num_channels = features.shape
    x, y, z = np.float64(point_mm[0]), np.float64(point_mm[1]), np.float64(point_mm[2])
    count = 0
    for view in range(num_views):
        M = P[view]
        depth = M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + M[2, 3]
        if not (is_used[view] and depth >= MIN_DEPTH_MM):
            continue
        u = (M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + M[0, 3]) / depth
        v = (M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + M[1, 3]) / depth
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            continue
        u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        left, top = int(u), int(v)
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        a, b, row, share = u - left, v - top, samples[count], shares[count]
        share[0], share[1], share[2], share[3] = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
        cell = cells[count]
        cell[0], cell[1], cell[2], cell[3], cell[4] = view, left, right, top, bottom
        s0, s1, s2, s3 = share[0], share[1], share[2], share[3]
        f0, f1 = features[view, top, left], features[view, top, right]
        f2, f3 = features[view, bottom, left], features[view, bottom, right]
        for c in range(num_channels):
            row[c] = s0 * f0[c] + s1 * f1[c] + s2 * f2[c] + s3 * f3[c]
        count += 1
    return count


@_compiled(inline=True)
def _exponentials(
    values: Float[np.ndarray, " channel"],
    peaks: Float[np.ndarray, " channel"],
    bits: Int32[np.ndarray, " channel"],
    powers: Float[np.ndarray, " channel"],
    results: Float[np.ndarray, " channel"],
) -> None:
    """Fill in exp(values - peaks) ≤ 1 to 2e-7: 2^q 2^f with integer q, whose bits are set, and |f| ≤ 1/2 by series.

    `powers` is the memory of `bits`, seen as float32. The library's exp takes one number at a time, this takes many.
    """
    for c in range(len(values)):
        t = max((values[c] - peaks[c]) * np.float32(1.442695041), np.float32(-126.0))
        q = np.int32(t - np.float32(0.5))
        bits[c] = (q + np.int32(127)) << np.int32(23)
        f = t - np.float32(q)
        tail = np.float32(0.0096181291) + f * (np.float32(0.0013333558) + f * np.float32(0.00015403530))
        middle = np.float32(0.24022651) + f * (np.float32(0.05550411) + f * tail)
        results[c] = np.float32(1.0) + f * (np.float32(0.69314718) + f * middle)
    for c in range(len(values)):
        results[c] *= powers[c]


@_compiled(inline=True)
def _weigh(
    samples: Float[np.ndarray, "view channel"],
    count: int,
    weights: Float[np.ndarray, "view channel"],
    rows: Float[np.ndarray, "3 channel"],
    bits: Int32[np.ndarray, " channel"],
    powers: Float[np.ndarray, " channel"],
) -> None:
    """Fill in the weights before they are divided by their sum, rows[1], and the weighted mean, rows[2]."""
    peak, total, mean = rows[0], rows[1], rows[2]
    for c in range(len(peak)):
        peak[c], total[c], mean[c] = samples[0, c], 0.0, 0.0
    for i in range(1, count):
        row = samples[i]
        for c in range(len(peak)):
            peak[c] = row[c] if row[c] > peak[c] else peak[c]
    for i in range(count):
        row, weight = samples[i], weights[i]
        if samples.itemsize == 4:
            _exponentials(row, peak, bits, powers, weight)
        else:
            for c in range(len(peak)):
                weight[c] = np.exp(row[c] - peak[c])
        for c in range(len(peak)):
            total[c] += weight[c]
            mean[c] += weight[c] * row[c]
    for c in range(len(peak)):
        mean[c] /= total[c]


@_compiled(inline=False)
def _fuse(
    features: Float[np.ndarray, "view height width channel"],
    P: Float[np.ndarray, "view 3 4"],
    points_mm: Float[np.ndarray, "point 3"],
    is_used: Bool[np.ndarray, " view"],
    fused: Float[np.ndarray, "point channel"],
) -> None:
    """Fill in the fused features of some points of one item."""
    num_views, num_channels = len(features), features.shape[-1]
    samples, weights = np.empty((2, num_views, num_channels), features.dtype)
    rows, shares = np.empty((3, num_channels), features.dtype), np.empty((num_views, 4), features.dtype)
    cells, bits = np.empty((num_views, 5), np.int64), np.empty(num_channels, np.int32)
    powers = bits.view(np.float32)
    for n in range(len(points_mm)):
        count = _sample_views(features, P, is_used, points_mm[n], samples, cells, shares)
        target, mean = fused[n], rows[2]
        if count:
            _weigh(samples, count, weights, rows, bits, powers)
        for c in range(num_channels):
            target[c] = mean[c] if count else 0.0


@_compiled(inline=False)
def _differentiate(
    features: Float[np.ndarray, "view height width channel"],
    P: Float[np.ndarray, "view 3 4"],
    points_mm: Float[np.ndarray, "point 3"],
    is_used: Bool[np.ndarray, " view"],
    upstream: Float[np.ndarray, "point channel"],
    sums: Float[np.ndarray, "view height width channel"],
) -> None:
    """Add what some points of one item contribute to the gradient of its features."""
    num_views, num_channels = len(features), features.shape[-1]
    samples, weights = np.empty((2, num_views, num_channels), features.dtype)
    rows, shares = np.empty((3, num_channels), features.dtype), np.empty((num_views, 4), features.dtype)
    cells, bits = np.empty((num_views, 5), np.int64), np.empty(num_channels, np.int32)
    powers, total, mean = bits.view(np.float32), rows[1], rows[2]
    for n in range(len(points_mm)):
        count = _sample_views(features, P, is_used, points_mm[n], samples, cells, shares)
        if count:
            _weigh(samples, count, weights, rows, bits, powers)
        above = upstream[n]
        for i in range(count):
            weight, row, cell, share = weights[i], samples[i], cells[i], shares[i]
            for c in range(num_channels):
                row[c] = above[c] * weight[c] / total[c] * (1 + row[c] - mean[c])
            for corner in range(4):
                s = share[corner]
                target = sums[cell[0], cell[3 + corner // 2], cell[1 + corner % 2]]
                for c in range(num_channels):
                    target[c] += s * row[c]
