"""Which detected person of one view is which of another, and which of the persons to follow.

Every pair of detections in two views is a hypothesis: its keypoints are triangulated in closed form and scored in all
views. The best hypothesis takes one person per view, then the next among what is left. No state outlives a call.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from assemblyhands_core.geometry.cameras import Camera

FloatArray = npt.NDArray[np.floating]
IntArray = npt.NDArray[np.int64]

# A view joins a person with at least this many keypoints, and this share of what it sees of that detection, in place.
_MIN_KEYPOINTS: Final = 5
_MIN_SHARE: Final = 1 / 3
# Rays closer to parallel than half a degree say nothing about depth.
_MIN_SIN_SQUARED: Final = float(np.sin(np.deg2rad(0.5)) ** 2)
_FRAMES_AT_ONCE: Final = 16
_NEARLY_EQUAL: Final = 0.2
# Tracks with less than this share of the best one's support are passers-by or ghosts: not worth a word to the user.
_NOTABLE: Final = 0.1


@dataclass(frozen=True, eq=False)
class PersonAssociation:
    """Persons that the views agree on, best first, frame by frame.

    Attributes:
        person_index: (F, P, V) which detection of the view is this person; -1 = none.
        points_world_mm: (F, P, K, 3) two-view triangulation of the winning hypothesis, world frame; NaN = missing.
    """

    person_index: IntArray
    points_world_mm: FloatArray

    @property
    def num_views(self) -> IntArray:
        """Return (F, P) how many views see each person; 0 = no such person."""
        return np.asarray((self.person_index >= 0).sum(axis=-1), dtype=np.int64)

    @property
    def center_world_mm(self) -> FloatArray:
        """Return (F, P, 3) the median of each person's points, world frame; NaN = no such person."""
        return _nan_median(self.points_world_mm)


class FollowedPerson(NamedTuple):
    """The one person that a shard is about.

    Attributes:
        person_index: (F, V) which detection of the view is the followed person; -1 = none.
        sentence: who was followed and why, for the user.
    """

    person_index: IntArray
    sentence: str


class _Hypotheses(NamedTuple):
    seeds: IntArray  # (H, 2, 2): two (view, detection)
    points: FloatArray  # (F, H, K, 3)
    score: FloatArray  # (F, H, V, N)


def associate_persons(
    keypoints_px: FloatArray,
    confidence: FloatArray,
    cameras: Sequence[Camera],
    *,
    max_reprojection_px: float,
    max_persons: int,
) -> PersonAssociation:
    """Assign the persons detected in several views to one another.

    Args:
        keypoints_px: (F, V, N, K, 2) raw pixels, up to N persons per view; NaN = missing.
        confidence: (F, V, N, K) weights in 0..1; 0 = missing.
        cameras: V cameras.
        max_reprojection_px: a keypoint agrees with a hypothesis when it lies within this distance.
        max_persons: at most so many persons are returned.

    Returns:
        Up to ``max_persons`` persons per frame, each seen by at least two views.

    Raises:
        ValueError: the arrays' shapes do not fit one another or the number of cameras.

    Source: paper, supplement, "Processing of exocentric images" (3D body keypoints by 2D + triangulation).
    """
    num_frames, num_views, num_detections, num_keypoints = _checked_shape(keypoints_px, confidence, cameras)
    index = np.full((num_frames, max_persons, num_views), -1, dtype=np.int64)
    points = np.full((num_frames, max_persons, num_keypoints, 3), np.nan)
    if num_views < 2 or num_detections == 0:
        return PersonAssociation(index, points)
    for start in range(0, num_frames, _FRAMES_AT_ONCE):
        chunk = slice(start, start + _FRAMES_AT_ONCE)
        hypotheses = _score_hypotheses(keypoints_px[chunk], confidence[chunk], cameras, max_reprojection_px)
        for person in range(max_persons):
            hypotheses, index[chunk, person], points[chunk, person] = _take_best(hypotheses)
    return PersonAssociation(index, points)


def _checked_shape(
    keypoints_px: FloatArray, confidence: FloatArray, cameras: Sequence[Camera]
) -> tuple[int, int, int, int]:
    if keypoints_px.ndim != 5 or keypoints_px.shape[-1] != 2 or keypoints_px.shape[:-1] != confidence.shape:
        raise ValueError(
            f"keypoints_px {keypoints_px.shape} must be (frames, views, persons, keypoints, 2) "
            f"and confidence {confidence.shape} the same without the last axis"
        )
    num_frames, num_views, num_detections, num_keypoints = confidence.shape
    if num_views != len(cameras):
        raise ValueError(f"keypoints_px holds {num_views} views but there are {len(cameras)} cameras")
    return num_frames, num_views, num_detections, num_keypoints


def _score_hypotheses(
    keypoints_px: FloatArray, confidence: FloatArray, cameras: Sequence[Camera], max_reprojection_px: float
) -> _Hypotheses:
    num_frames, num_views, num_detections = confidence.shape[:3]
    weight = np.where(np.isfinite(keypoints_px).all(axis=-1), np.nan_to_num(confidence), 0.0)
    detections = [(view, person) for view in range(num_views) for person in range(num_detections)]
    seeds = np.array([(a, b) for a, b in combinations(detections, 2) if a[0] != b[0]], dtype=np.int64)
    rays = np.stack([camera.unproject(keypoints_px[:, v]) for v, camera in enumerate(cameras)], axis=1)
    centers = np.stack([camera.center_world_mm for camera in cameras])
    first, second = seeds[:, 0], seeds[:, 1]
    points = midpoints(
        centers[first[:, 0]][None, :, None],
        rays[:, first[:, 0], first[:, 1]],
        centers[second[:, 0]][None, :, None],
        rays[:, second[:, 0], second[:, 1]],
    )
    score = np.zeros((num_frames, len(seeds), num_views, num_detections))
    for view, camera in enumerate(cameras):
        projected = camera.project(points)[:, :, None]
        error = np.linalg.norm(projected - keypoints_px[:, None, view], axis=-1)
        score[:, :, view] = _agreement(error, weight[:, None, view], max_reprojection_px)
    return _Hypotheses(seeds, points, score)


def _agreement(error_px: FloatArray, weight: FloatArray, max_reprojection_px: float) -> FloatArray:
    """Return (F, H, N): the weight of a detection's keypoints in place, 0 where too few are; ties go to the closer.

    Args:
        error_px: (F, H, N, K); NaN = missing.
        weight: (F, 1, N, K); 0 = missing.
        max_reprojection_px: largest error of a keypoint in place.
    """
    closeness = np.maximum(0.0, 1.0 - np.nan_to_num(error_px, nan=np.inf) / max_reprojection_px)
    in_place = (closeness > 0) & (weight > 0)
    count = in_place.sum(axis=-1)
    enough = (count >= _MIN_KEYPOINTS) & (count >= _MIN_SHARE * (weight > 0).sum(axis=-1))
    # Closeness counts so little that it decides only between hypotheses of equal support.
    return np.asarray(np.where(enough, (in_place * weight * (1.0 + 1e-3 * closeness)).sum(axis=-1), 0.0))


def _take_best(hypotheses: _Hypotheses) -> tuple[_Hypotheses, IntArray, FloatArray]:
    """Return what remains, the best person's detection per view (F, V), -1 = none, and its points (F, K, 3)."""
    seeds, points, score = hypotheses
    frames = np.arange(len(score))
    first, second = seeds[:, 0], seeds[:, 1]
    row = np.arange(len(seeds))
    stands = (score[:, row, first[:, 0], first[:, 1]] > 0) & (score[:, row, second[:, 0], second[:, 1]] > 0)
    total = np.where(stands, score.max(axis=-1).sum(axis=-1), 0.0)
    best = total.argmax(axis=-1)
    best_score = score[frames, best]
    is_found = total[frames, best] > 0
    index = np.where(is_found[:, None] & (best_score.max(axis=-1) > 0), best_score.argmax(axis=-1), -1)
    taken = index[:, :, None] == np.arange(score.shape[-1])
    remaining = np.where(taken[:, None], 0.0, score)
    return (
        hypotheses._replace(score=remaining),
        index,
        np.where(is_found[:, None, None], points[frames, best], np.nan),
    )


def midpoints(
    first_center: FloatArray, first_ray: FloatArray, second_center: FloatArray, second_ray: FloatArray
) -> FloatArray:
    """Return the points halfway between pairs of rays where these come closest.

    Args:
        first_center: (..., 3) mm.
        first_ray: (..., 3) unit direction.
        second_center: (..., 3) mm.
        second_ray: (..., 3) unit direction.

    Returns:
        (..., 3) mm; NaN where a ray is missing, the rays are parallel, or meet behind a camera.
    """
    cosine = (first_ray * second_ray).sum(axis=-1)
    sine_squared = 1.0 - cosine**2
    baseline = second_center - first_center
    along_first = (baseline * first_ray).sum(axis=-1)
    along_second = (baseline * second_ray).sum(axis=-1)
    is_crossing = sine_squared > _MIN_SIN_SQUARED
    divisor = np.where(is_crossing, sine_squared, 1.0)
    first_depth = (along_first - cosine * along_second) / divisor
    second_depth = (cosine * along_first - along_second) / divisor
    middle = (
        first_center + first_depth[..., None] * first_ray + second_center + second_depth[..., None] * second_ray
    ) / 2
    is_in_front = is_crossing & (first_depth > 0) & (second_depth > 0)
    return np.where(is_in_front[..., None], middle, np.nan)


def _nan_median(points: FloatArray) -> FloatArray:
    """Return the median over the last but one axis, NaN where all are missing."""
    median = np.full((*points.shape[:-2], points.shape[-1]), np.nan)
    has_any = np.isfinite(points).all(axis=-1).any(axis=-1)
    median[has_any] = np.nanmedian(points[has_any], axis=-2)
    return median


def point_looked_at(cameras: Sequence[Camera]) -> FloatArray:
    """Return the point (3,) mm nearest to all optical axes, in the least-squares sense.

    Axes that are all parallel meet nowhere: then the point nearest to the cameras' centres is taken.
    """
    axes = np.stack([camera.T_camera_from_world[2, :3] for camera in cameras])
    centers = np.stack([camera.center_world_mm for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = centers.mean(axis=0)
    right = (across @ (centers - middle)[..., None]).sum(axis=0)[:, 0]
    return np.asarray(middle + np.linalg.lstsq(across.sum(axis=0), right, rcond=1e-6)[0])


def follow_person(
    association: PersonAssociation, cameras: Sequence[Camera], *, max_step_mm: float = 500.0
) -> FollowedPerson:
    """Choose the person whom the views see most, and say why.

    Persons are linked from frame to frame by distance. The one seen by most views in most frames is followed; persons
    seen almost as much (within a fifth) are told apart by nearness to the point that the cameras look at, so that
    shards of one sequence, each on its own, follow the same person.

    Args:
        association: persons frame by frame.
        cameras: V cameras.
        max_step_mm: how far a person's centre may move from where it was last seen.

    Returns:
        The followed person's detection per frame and view, and the sentence.
    """
    center = association.center_world_mm
    tracks = _link(center, max_step_mm)
    if not tracks:
        return FollowedPerson(
            np.full(association.person_index[:, 0].shape, -1, dtype=np.int64),
            "followed nobody: no person fits two views",
        )
    support = np.array([sum(int(association.num_views[f, p]) for f, p in track.items()) for track in tracks])
    distance = _distances_mm(tracks, center, point_looked_at(cameras))
    order = np.argsort(-support, kind="stable")
    rivals = [track for track in order if support[track] >= (1 - _NEARLY_EQUAL) * support[order[0]]]
    chosen = min(rivals, key=lambda track: distance[track])
    index = np.full(association.person_index[:, 0].shape, -1, dtype=np.int64)
    for frame, person in tracks[chosen].items():
        index[frame] = association.person_index[frame, person]
    return FollowedPerson(index, _sentence(support, distance, chosen, len(rivals), index.shape))


def _link(center_world_mm: FloatArray, max_step_mm: float) -> list[dict[int, int]]:
    """Return tracks, frame → person, by repeatedly joining the closest person (F, P, 3) and track of a frame."""
    tracks: list[dict[int, int]] = []
    for frame, centers in enumerate(center_world_mm):
        last = np.array([center_world_mm[max(track.items())] for track in tracks]).reshape(-1, 3)
        distance = np.linalg.norm(last[:, None] - centers[None], axis=-1)
        distance = np.where(distance <= max_step_mm, distance, np.inf)
        unlinked = np.isfinite(centers).all(axis=-1)
        while distance.size and np.isfinite(distance.min()):
            track, person = np.unravel_index(distance.argmin(), distance.shape)
            tracks[track][frame] = int(person)
            distance[track], distance[:, person], unlinked[person] = np.inf, np.inf, False
        tracks += [{frame: int(person)} for person in np.flatnonzero(unlinked)]
    return tracks


def _distances_mm(tracks: list[dict[int, int]], center_world_mm: FloatArray, target_mm: FloatArray) -> FloatArray:
    """Return (T,) the median distance of each track from a point."""
    places = [center_world_mm[list(track), list(track.values())] for track in tracks]
    return np.array([np.median(np.linalg.norm(place - target_mm, axis=-1)) for place in places])


def _sentence(support: IntArray, distance_mm: FloatArray, chosen: int, num_rivals: int, shape: tuple[int, ...]) -> str:
    num_frames, num_views = shape
    views = support / num_frames
    notable = np.flatnonzero(support >= _NOTABLE * support.max()).tolist()
    ranked = sorted(notable, key=lambda track: -int(support[track]))
    text = f"seen in {views[chosen]:.1f} of {num_views} views on average"
    where = f"{distance_mm[chosen] / 1000:.1f} m from the point that the cameras look at"
    if len(ranked) == 1:
        return f"followed the only person: {text}; {where}"
    rest = ", ".join(f"{views[track]:.1f}" for track in ranked if track != chosen)
    others = ", ".join(f"{distance_mm[track] / 1000:.1f} m" for track in ranked if track != chosen)
    reason = "nearly equal, so the nearest" if num_rivals > 1 else "the most"
    return (
        f"followed person {ranked.index(chosen) + 1} of {len(ranked)}: {text} against {rest} ({reason}); "
        f"{where} against {others}"
    )
