"""Two-view hypotheses of points, scored in all views: where a robust triangulation starts from.

Up to 8 views all pairs are tried. With more, each point gets the same number of pairs, so that time grows linearly in
the number of views: all pairs are dealt into as many groups, and from each group the point takes its best conditioned
pair (angle between the rays, confidence). Only points of which the winner explains less than half get all pairs.
"""

from functools import cache
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64, Int

from assemblyhands_core.geometry.sightlines import Sightlines

NUM_PAIRS = 28
_MAX_SCORES = 1 << 20  # scores held in memory at once
_HARD = 0.5  # share of unexplained confidence above which a point is tried with all pairs


def best_hypotheses(
    lines: Sightlines, max_reprojection_px: float, min_parallax_rad: float
) -> tuple[Float64[np.ndarray, "point 3"], Bool[np.ndarray, " point"]]:
    """Return for each point the two-view intersection that most views agree with.

    Args:
        lines: Observations of the points.
        max_reprojection_px: Pixel error beyond which a view counts as not explained.
        min_parallax_rad: Smallest angle between two rays that may found a hypothesis.

    Returns:
        Points in mm, NaN where no two rays meet in front of their cameras, and whether any two rays were far enough
        from parallel.
    """
    quality = _pair_quality(lines, min_parallax_rad)
    groups = _pair_groups(lines.rays.shape[1], NUM_PAIRS)
    points, cost = _best_of_groups(lines, quality, groups, max_reprojection_px)
    if groups.shape[1] > 1:
        hard = np.flatnonzero(cost > _HARD * lines.confidence.sum(axis=1))
        every_pair = _pair_groups(lines.rays.shape[1], quality.shape[1])
        points[hard], _ = _best_of_groups(lines.select(hard), quality[hard], every_pair, max_reprojection_px)
    return points, np.asarray((quality > 0).any(axis=1))


@cache
def _pairs(num_views: int) -> Int[np.ndarray, "pair 2"]:
    """Return all pairs, by distance of their numbers so that neighbours in the list differ in their views."""
    pairs = sorted(combinations(range(num_views), 2), key=lambda pair: (pair[1] - pair[0], pair[0]))
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


@cache
def _pair_groups(num_views: int, num_groups: int) -> Int[np.ndarray, "group member"]:
    """Deal the indices of all pairs into groups; short groups repeat their last pair."""
    parts = np.array_split(np.arange(len(_pairs(num_views))), min(num_groups, len(_pairs(num_views))))
    size = max(len(part) for part in parts)
    return np.array([np.pad(part, (0, size - len(part)), mode="edge") for part in parts])


def _pair_quality(lines: Sightlines, min_parallax_rad: float) -> Float64[np.ndarray, "point pair"]:
    """Return sin² of the angle times both confidences, 0 where a pair can found no hypothesis."""
    first, second = _pairs(lines.rays.shape[1]).T
    cosine = (lines.rays @ lines.rays.swapaxes(1, 2))[:, first, second]
    squared_sine = 1 - cosine * cosine
    apart = np.linalg.norm(lines.centers_mm[first] - lines.centers_mm[second], axis=1) > 0
    quality = squared_sine * lines.confidence[:, first] * lines.confidence[:, second] * apart
    quality[squared_sine < np.sin(min_parallax_rad) ** 2] = 0.0
    return np.asarray(quality)


def _best_of_groups(
    lines: Sightlines,
    quality: Float64[np.ndarray, "point pair"],
    groups: Int[np.ndarray, "group member"],
    max_reprojection_px: float,
) -> tuple[Float64[np.ndarray, "point 3"], Float64[np.ndarray, " point"]]:
    """Return the best points and their costs, in pieces of bounded memory."""
    points, cost = np.full((len(quality), 3), np.nan), np.full(len(quality), np.inf)
    piece = max(1, _MAX_SCORES // (len(groups) * lines.rays.shape[1]))
    for begin in range(0, len(quality), piece):
        rows = np.arange(begin, min(begin + piece, len(quality)))
        part = lines.select(rows)
        chosen = _choose(quality[rows], groups)
        candidates = _intersect(part, chosen, np.take_along_axis(quality[rows], chosen, axis=1) > 0)
        costs = _truncated_cost(part, candidates, max_reprojection_px)
        best = np.argmin(costs, axis=1)
        points[rows], cost[rows] = candidates[np.arange(len(rows)), best], costs[np.arange(len(rows)), best]
    return points, cost


def _choose(
    quality: Float64[np.ndarray, "point pair"], groups: Int[np.ndarray, "group member"]
) -> Int[np.ndarray, "point group"]:
    """Return the index of the best pair of each group."""
    if groups.shape[1] == 1:
        return np.broadcast_to(groups[:, 0], (len(quality), len(groups)))
    best = np.argmax(quality[:, groups], axis=2)
    return np.asarray(groups[np.arange(len(groups)), best])


def _intersect(
    lines: Sightlines, chosen: Int[np.ndarray, "point group"], allowed: Bool[np.ndarray, "point group"]
) -> Float64[np.ndarray, "point group 3"]:
    """Return the points nearest to both rays of each chosen pair; NaN unless in front of both cameras.

    Each ray's nearest point is weighted by 1/depth², which makes the compromise one of angles instead of millimetres.
    """
    first, second = _pairs(lines.rays.shape[1])[chosen].transpose(2, 0, 1)
    point = np.arange(len(chosen))[:, None]
    ray_1, ray_2 = lines.rays[point, first], lines.rays[point, second]
    center_1, center_2 = lines.centers_mm[first], lines.centers_mm[second]
    cosine = (ray_1 * ray_2).sum(axis=-1)
    along_1, along_2 = ((center_2 - center_1) * ray_1).sum(axis=-1), ((center_2 - center_1) * ray_2).sum(axis=-1)
    squared_sine = np.where(allowed, 1 - cosine * cosine, np.nan)
    depth_1 = (along_1 - cosine * along_2) / squared_sine
    depth_2 = (cosine * along_1 - along_2) / squared_sine
    in_front = (depth_1 > 0) & (depth_2 > 0)
    share = np.where(in_front, depth_2**2 / (depth_1**2 + depth_2**2), np.nan)[..., None]
    near_1, near_2 = center_1 + depth_1[..., None] * ray_1, center_2 + depth_2[..., None] * ray_2
    return np.asarray(share * near_1 + (1 - share) * near_2)


def _truncated_cost(
    lines: Sightlines, candidates: Float64[np.ndarray, "point group 3"], max_reprojection_px: float
) -> Float64[np.ndarray, "point group"]:
    """Return Σ over views of confidence · min(error²/threshold², 1); infinite for NaN candidates.

    Single precision is plenty for choosing, and coordinates are taken from the middle of the cameras to keep it so.
    """
    num_points, num_views = lines.confidence.shape
    middle = lines.centers_mm.mean(axis=0)
    directions = np.concatenate((lines.rows, lines.rays[:, :, None]), axis=2)
    offsets = directions @ (middle - lines.centers_mm)[..., None]
    maps = np.concatenate((directions, offsets), axis=-1).swapaxes(1, 2).reshape(num_points, 3 * num_views, 4)
    homogeneous = np.concatenate((candidates - middle, np.ones_like(candidates[..., :1])), axis=-1)
    seen = homogeneous.astype(np.float32) @ maps.astype(np.float32).swapaxes(1, 2)
    u, v, depth = (seen[..., i * num_views : (i + 1) * num_views] for i in range(3))
    limit = np.float32(max_reprojection_px) * depth
    limit *= limit
    error = u * u + v * v
    np.divide(error, limit, out=error, where=limit > 0)
    error[(depth <= 0) | (error > 1)] = 1.0
    cost = (error @ lines.confidence.astype(np.float32)[..., None])[..., 0].astype(np.float64)
    return np.where(np.isnan(cost), np.inf, cost)
