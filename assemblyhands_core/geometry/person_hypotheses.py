"""Hypotheses of where a person is: two detections in two views, triangulated in closed form, scored in all views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from assemblyhands_core.geometry.cameras import Camera

# A view joins a person with at least this many keypoints, and this share of what it sees of that detection, in place.
_MIN_KEYPOINTS: Final = 5
_MIN_SHARE: Final = 1 / 3
# Rays closer to parallel than half a degree say nothing about depth.
_MIN_SIN_SQUARED: Final = float(np.sin(np.deg2rad(0.5)) ** 2)
# A detection taken for its mirror image must explain this much more: most detectors are right most of the time.
_MIRRORED_WORTH: Final = 0.9


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """All pairs of candidates of different views, over some frames.

    A candidate is a detection (0..N-1) or, where sides may be exchanged, its mirror image (N..2N-1).

    Attributes:
        seeds: the two (view, candidate) of each.
        points_world_mm: NaN = missing.
        score: weight of each candidate's keypoints that lie where the hypothesis says; 0 = refused.
        num_detections: N.
    """

    seeds: Int[np.ndarray, "hypothesis 2 2"]
    points_world_mm: Float[np.ndarray, "frame hypothesis keypoint 3"]
    score: Float[np.ndarray, "frame hypothesis view candidate"]
    num_detections: int

    def best(self) -> tuple[Int[np.ndarray, "frame view"], Float[np.ndarray, "frame keypoint 3"]]:
        """Return the best hypothesis' candidate per view, -1 = none, and its points in mm, NaN = missing."""
        frames, rows = np.arange(len(self.score)), np.arange(len(self.seeds))
        (first_view, first), (second_view, second) = self.seeds[:, 0].T, self.seeds[:, 1].T
        stands = (self.score[:, rows, first_view, first] > 0) & (self.score[:, rows, second_view, second] > 0)
        total = np.where(stands, self.score.max(axis=-1).sum(axis=-1), 0.0)
        best = total.argmax(axis=-1)
        score = self.score[frames, best]
        is_found = total[frames, best] > 0
        candidate = np.where(is_found[:, None] & (score.max(axis=-1) > 0), score.argmax(axis=-1), -1)
        return candidate, np.where(is_found[:, None, None], self.points_world_mm[frames, best], np.nan)

    def without(self, candidate: Int[np.ndarray, "frame view"]) -> "Hypotheses":
        """Return what remains when each view's candidate, as itself and mirrored, is taken; -1 takes none."""
        others = np.arange(self.score.shape[-1]) % self.num_detections
        taken = (candidate[:, :, None] >= 0) & (candidate[:, :, None] % self.num_detections == others)
        return replace(self, score=np.where(taken[:, None], 0.0, self.score))


def score_hypotheses(
    keypoints_px: Float[np.ndarray, "frame view detection keypoint 2"],
    confidence: Float[np.ndarray, "frame view detection keypoint"],
    cameras: Sequence[Camera],
    max_reprojection_px: float,
    mirror: Sequence[int] | None,
) -> Hypotheses:
    """Triangulate every pair of candidates and score it in all views.

    Args:
        keypoints_px: raw pixels; NaN = missing.
        confidence: weights in 0..1; 0 = missing.
        cameras: one for each view.
        max_reprojection_px: a keypoint is in place within this distance.
        mirror: each keypoint's counterpart of the other side, where a detection may have them exchanged.
    """
    num_detections = keypoints_px.shape[2]
    weight = np.where(np.isfinite(keypoints_px).all(axis=-1), np.nan_to_num(confidence), 0.0)
    if mirror is not None:
        keypoints_px = np.concatenate([keypoints_px, keypoints_px[:, :, :, list(mirror)]], axis=2)
        weight = np.concatenate([weight, _MIRRORED_WORTH * weight[..., list(mirror)]], axis=2)
    seeds = _seeds(len(cameras), num_detections, weight.shape[2])
    points = _triangulate_seeds(keypoints_px, cameras, seeds)
    score = np.zeros((len(points), len(seeds), *weight.shape[1:3]))
    for view, camera in enumerate(cameras):
        projected = camera.project(points)[:, :, None]
        error = np.linalg.norm(projected - keypoints_px[:, None, view], axis=-1)
        score[:, :, view] = _agreement(error, weight[:, None, view], max_reprojection_px)
    return Hypotheses(seeds, points, score, num_detections)


def midpoints(
    first_center_mm: Float[np.ndarray, "*#batch 3"],
    first_ray: Float[np.ndarray, "*#batch 3"],
    second_center_mm: Float[np.ndarray, "*#batch 3"],
    second_ray: Float[np.ndarray, "*#batch 3"],
) -> Float[np.ndarray, "*batch 3"]:
    """Return the points halfway between pairs of rays (unit vectors) where these come closest.

    Returns:
        Points in mm; NaN where a ray is missing, the rays are parallel, or meet behind a camera.
    """
    cosine = (first_ray * second_ray).sum(axis=-1)
    sine_squared = 1.0 - cosine**2
    baseline = second_center_mm - first_center_mm
    along_first = (baseline * first_ray).sum(axis=-1)
    along_second = (baseline * second_ray).sum(axis=-1)
    is_crossing = sine_squared > _MIN_SIN_SQUARED
    divisor = np.where(is_crossing, sine_squared, 1.0)
    first_depth = (along_first - cosine * along_second) / divisor
    second_depth = (cosine * along_first - along_second) / divisor
    is_in_front = is_crossing & (first_depth > 0) & (second_depth > 0)
    on_first = first_center_mm + first_depth[..., None] * first_ray
    on_second = second_center_mm + second_depth[..., None] * second_ray
    return np.where(is_in_front[..., None], (on_first + on_second) / 2, np.nan)


def _seeds(num_views: int, num_detections: int, num_candidates: int) -> Int[np.ndarray, "hypothesis 2 2"]:
    candidates = [(view, candidate) for view in range(num_views) for candidate in range(num_candidates)]
    pairs = [
        (first, second)
        for first, second in combinations(candidates, 2)
        # Two mirror images say the same as the two themselves.
        if first[0] != second[0] and min(first[1], second[1]) < num_detections
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2, 2)


def _triangulate_seeds(
    keypoints_px: Float[np.ndarray, "frame view candidate keypoint 2"],
    cameras: Sequence[Camera],
    seeds: Int[np.ndarray, "hypothesis 2 2"],
) -> Float[np.ndarray, "frame hypothesis keypoint 3"]:
    rays = np.stack([camera.unproject(keypoints_px[:, v]) for v, camera in enumerate(cameras)], axis=1)
    centers = np.stack([camera.center_world_mm for camera in cameras])
    (first_view, first), (second_view, second) = seeds[:, 0].T, seeds[:, 1].T
    return midpoints(
        centers[first_view][None, :, None],
        rays[:, first_view, first],
        centers[second_view][None, :, None],
        rays[:, second_view, second],
    )


def _agreement(
    error_px: Float[np.ndarray, "frame hypothesis candidate keypoint"],
    weight: Float[np.ndarray, "frame 1 candidate keypoint"],
    max_reprojection_px: float,
) -> Float[np.ndarray, "frame hypothesis candidate"]:
    """Return the weight of a candidate's keypoints in place, 0 where too few are; ties go to the closer.

    Args:
        error_px: NaN = missing.
        weight: 0 = missing.
        max_reprojection_px: largest error of a keypoint in place.
    """
    closeness = np.maximum(0.0, 1.0 - np.nan_to_num(error_px, nan=np.inf) / max_reprojection_px)
    in_place = (closeness > 0) & (weight > 0)
    count = in_place.sum(axis=-1)
    enough = (count >= _MIN_KEYPOINTS) & (count >= _MIN_SHARE * (weight > 0).sum(axis=-1))
    # Closeness counts so little that it decides only between hypotheses of equal support.
    return np.where(enough, (in_place * weight * (1.0 + 1e-3 * closeness)).sum(axis=-1), 0.0)
