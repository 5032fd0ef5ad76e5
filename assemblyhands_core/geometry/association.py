"""Which detected person of one view is which of another, and which of the persons to follow.

Every pair of detections in two views is a hypothesis that is scored in all views. The best hypothesis takes one person
per view, then the next among what is left. Body detectors sometimes exchange left and right of a whole person (seen
from behind above all): given the keypoints' counterparts, a view is also tried with its sides exchanged, so that right
stays right in all views. No state outlives a call.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.person_hypotheses import score_hypotheses

Detections = Float[np.ndarray, "frame view detection keypoint 2"]
Confidences = Float[np.ndarray, "frame view detection keypoint"]

_FRAMES_AT_ONCE: Final = 16
_NEARLY_EQUAL: Final = 0.2
_JUMP_COST: Final = 2.0
# Tracks with less than this share of the best one's support are passers-by or ghosts: not worth a word to the user.
_NOTABLE: Final = 0.1


@dataclass(frozen=True, eq=False)
class PersonAssociation:
    """Persons that the views agree on, best first, frame by frame.

    Attributes:
        person_index: which detection of the view is this person; -1 = none.
        is_mirrored: that detection has left and right exchanged.
        points_world_mm: two-view triangulation of the winning hypothesis, world frame; NaN = missing.
    """

    person_index: Int[np.ndarray, "frame person view"]
    is_mirrored: Bool[np.ndarray, "frame person view"]
    points_world_mm: Float[np.ndarray, "frame person keypoint 3"]

    @property
    def num_views(self) -> Int[np.ndarray, "frame person"]:
        """Return how many views see each person; 0 = no such person."""
        return np.asarray((self.person_index >= 0).sum(axis=-1), dtype=np.int64)

    @property
    def center_world_mm(self) -> Float[np.ndarray, "frame person 3"]:
        """Return the median of each person's points, world frame; NaN = no such person."""
        return _nan_median(self.points_world_mm)


@dataclass(frozen=True, eq=False)
class FollowedPerson:
    """The one person that a shard is about.

    Attributes:
        person_index: which detection of the view is the followed person; -1 = none.
        is_mirrored: that detection has left and right exchanged.
        sentence: who was followed and why, for the user.
    """

    person_index: Int[np.ndarray, "frame view"]
    is_mirrored: Bool[np.ndarray, "frame view"]
    sentence: str

    def select(
        self, keypoints_px: Detections, confidence: Confidences, mirror: Sequence[int] | None = None
    ) -> tuple[Float[np.ndarray, "frame view keypoint 2"], Float[np.ndarray, "frame view keypoint"]]:
        """Return the followed person's own keypoints and confidence, left being left in every view.

        Args:
            keypoints_px: as given to ``associate_persons``.
            confidence: as given to ``associate_persons``.
            mirror: as given to ``associate_persons``.

        Returns:
            Raw pixels, NaN = missing, and their confidence, 0 = missing.
        """
        is_seen = self.person_index >= 0
        if keypoints_px.shape[2] == 0:
            empty = np.zeros(confidence.sum(axis=2).shape)
            return np.full((*empty.shape, 2), np.nan), empty
        index = np.maximum(self.person_index, 0)[:, :, None, None]
        chosen_px = np.take_along_axis(keypoints_px, index[..., None], axis=2)[:, :, 0]
        chosen = np.take_along_axis(confidence, index, axis=2)[:, :, 0]
        if mirror is not None:
            chosen_px = np.where(self.is_mirrored[..., None, None], chosen_px[:, :, list(mirror)], chosen_px)
            chosen = np.where(self.is_mirrored[..., None], chosen[:, :, list(mirror)], chosen)
        return np.where(is_seen[..., None, None], chosen_px, np.nan), np.where(is_seen[..., None], chosen, 0.0)


def associate_persons(
    keypoints_px: Detections,
    confidence: Confidences,
    cameras: Sequence[Camera],
    *,
    max_reprojection_px: float,
    max_persons: int,
    mirror: Sequence[int] | None = None,
) -> PersonAssociation:
    """Assign the persons detected in several views to one another.

    Args:
        keypoints_px: raw pixels; NaN = missing.
        confidence: weights in 0..1; 0 = missing.
        cameras: one for each view.
        max_reprojection_px: a keypoint agrees with a hypothesis when it lies within this distance.
        max_persons: at most so many persons are returned.
        mirror: each keypoint's counterpart of the other side; None = detections have their sides right.

    Returns:
        Up to ``max_persons`` persons per frame, each seen by at least two views.

    Raises:
        ValueError: the arrays' shapes do not fit one another or the number of cameras.

    Source: paper, supplement, "Processing of exocentric images" (3D body keypoints by 2D + triangulation).
    """
    _check_shapes(keypoints_px, confidence, cameras)
    num_frames, num_views, num_detections, num_keypoints = confidence.shape
    candidate = np.full((num_frames, max_persons, num_views), -1, dtype=np.int64)
    points = np.full((num_frames, max_persons, num_keypoints, 3), np.nan)
    for start in range(0, num_frames if num_views > 1 and num_detections > 0 else 0, _FRAMES_AT_ONCE):
        chunk = slice(start, start + _FRAMES_AT_ONCE)
        left = score_hypotheses(keypoints_px[chunk], confidence[chunk], cameras, max_reprojection_px, mirror)
        for person in range(max_persons):
            candidate[chunk, person], points[chunk, person] = left.best()
            left = left.without(candidate[chunk, person])
    index = np.where(candidate >= 0, candidate % max(num_detections, 1), -1)
    return PersonAssociation(index, candidate >= max(num_detections, 1), points)


def _check_shapes(keypoints_px: Detections, confidence: Confidences, cameras: Sequence[Camera]) -> None:
    if keypoints_px.ndim != 5 or keypoints_px.shape[-1] != 2 or keypoints_px.shape[:-1] != confidence.shape:
        raise ValueError(
            f"keypoints_px {keypoints_px.shape} must be (frames, views, persons, keypoints, 2) "
            f"and confidence {confidence.shape} the same without the last axis"
        )
    if confidence.shape[1] != len(cameras):
        raise ValueError(f"keypoints_px holds {confidence.shape[1]} views but there are {len(cameras)} cameras")


def follow_person(
    association: PersonAssociation,
    cameras: Sequence[Camera],
    *,
    mirror: Sequence[int] | None = None,
    max_step_mm: float = 500.0,
) -> FollowedPerson:
    """Choose the person whom the views see most, and say why.

    Persons are linked from frame to frame by distance. The one seen by most views in most frames is followed; persons
    seen almost as much (within a fifth) are told apart by nearness to the point that the cameras look at, so that
    shards of one sequence, each on its own, follow the same person.

    Args:
        association: persons frame by frame.
        cameras: V cameras.
        mirror: (K,) as given to ``associate_persons``; where half the views have their sides exchanged, the frames
            before and the majority of the track decide which half is right.
        max_step_mm: how far a person's centre may move from where it was last seen.

    Returns:
        The followed person's detection per frame and view, and the sentence.
    """
    center = association.center_world_mm
    num_frames, _, num_views = association.person_index.shape
    index = np.full((num_frames, num_views), -1, dtype=np.int64)
    is_mirrored = np.zeros((num_frames, num_views), dtype=np.bool_)
    tracks = _link(center, max_step_mm)
    if not tracks:
        return FollowedPerson(index, is_mirrored, "followed nobody: no person fits two views")
    support = np.array([sum(int(association.num_views[step]) for step in track.items()) for track in tracks])
    distance = _distances_mm(tracks, center, point_looked_at(cameras))
    rivals = np.flatnonzero(support >= (1 - _NEARLY_EQUAL) * support.max()).tolist()
    chosen = min(rivals, key=lambda track: float(distance[track]))
    frames, persons = list(tracks[chosen]), list(tracks[chosen].values())
    index[frames] = association.person_index[frames, persons]
    is_mirrored[frames] = association.is_mirrored[frames, persons]
    if mirror is not None:
        num_mirrored, num_seen = is_mirrored[frames].sum(axis=1), (index[frames] >= 0).sum(axis=1)
        exchanged = _exchanged(association.points_world_mm[frames, persons], list(mirror), num_mirrored, num_seen)
        is_mirrored[frames] = (is_mirrored[frames] ^ exchanged[:, None]) & (index[frames] >= 0)
    num_occupied = int((association.num_views > 0).any(axis=1).sum())
    sentence = _sentence(support / num_occupied, distance, chosen, len(rivals), num_views)
    return FollowedPerson(index, is_mirrored, sentence)


def _exchanged(
    points_world_mm: Float[np.ndarray, "frame keypoint 3"],
    mirror: list[int],
    num_mirrored: Int[np.ndarray, " frame"],
    num_seen: Int[np.ndarray, " frame"],
) -> Bool[np.ndarray, " frame"]:
    """Return in which frames of a track left and right must be exchanged once more.

    The labelling of least cost over the track: each view that must be taken for its mirror image costs 1, each jump of
    left to right from one frame to the next costs ``_JUMP_COST``. So where as many views say one as the other the
    frames around decide, and somebody who turned round unseen is not mistaken for ever.

    Args:
        points_world_mm: the person's points as the frames' best hypotheses label them.
        mirror: counterparts.
        num_mirrored: views whose sides those hypotheses exchange.
        num_seen: views that see the person.
    """
    paired = [k for k, other in enumerate(mirror) if k != other]
    counterparts = [mirror[k] for k in paired]
    view_cost = np.stack([num_mirrored, num_seen - num_mirrored], axis=1).astype(np.float64)
    cost, came_from = view_cost[0], []
    for previous, points, views in zip(points_world_mm, points_world_mm[1:], view_cost[1:], strict=False):
        jumps = _median_distance(points[counterparts], previous[paired]) < _median_distance(
            points[paired], previous[paired]
        )
        through = cost[:, None] + _JUMP_COST * (np.eye(2) if jumps else 1 - np.eye(2))
        came_from.append(through.argmin(axis=0))
        cost = through.min(axis=0) + views
    states = [int(cost.argmin())]
    for origin in reversed(came_from):
        states.append(int(origin[states[-1]]))
    return np.array(states[::-1], dtype=np.bool_)


def _median_distance(points: Float[np.ndarray, "keypoint 3"], others: Float[np.ndarray, "keypoint 3"]) -> float:
    distance = np.linalg.norm(points - others, axis=-1)
    known = distance[np.isfinite(distance)]
    return float(np.median(known)) if len(known) else np.inf


def point_looked_at(cameras: Sequence[Camera]) -> Float[np.ndarray, "3"]:
    """Return the point in mm nearest to all optical axes, in the least-squares sense.

    Axes that are all parallel meet nowhere: then the point nearest to the cameras' centres is taken.
    """
    axes = np.stack([camera.T_camera_from_world[2, :3] for camera in cameras])
    centers = np.stack([camera.center_world_mm for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = centers.mean(axis=0)
    right = (across @ (centers - middle)[..., None]).sum(axis=0)[:, 0]
    return np.asarray(middle + np.linalg.lstsq(across.sum(axis=0), right, rcond=1e-6)[0])


def _nan_median(points: Float[np.ndarray, "*batch keypoint 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the median over the last but one axis, NaN where all are missing."""
    median = np.full((*points.shape[:-2], points.shape[-1]), np.nan)
    has_any = np.isfinite(points).all(axis=-1).any(axis=-1)
    median[has_any] = np.nanmedian(points[has_any], axis=-2)
    return median


def _link(center_world_mm: Float[np.ndarray, "frame person 3"], max_step_mm: float) -> list[dict[int, int]]:
    """Return tracks, frame → person, by repeatedly joining the closest person and track of a frame."""
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


def _distances_mm(
    tracks: list[dict[int, int]],
    center_world_mm: Float[np.ndarray, "frame person 3"],
    target_mm: Float[np.ndarray, "3"],
) -> Float[np.ndarray, " track"]:
    """Return the median distance of each track from a point."""
    places = [center_world_mm[list(track), list(track.values())] for track in tracks]
    return np.array([np.median(np.linalg.norm(place - target_mm, axis=-1)) for place in places])


def _sentence(
    mean_views: Float[np.ndarray, " track"],
    distance_mm: Float[np.ndarray, " track"],
    chosen: int,
    num_rivals: int,
    num_views: int,
) -> str:
    notable = np.flatnonzero(mean_views >= _NOTABLE * mean_views.max()).tolist()
    ranked = sorted(notable, key=lambda track: -float(mean_views[track]))
    text = f"seen in {mean_views[chosen]:.1f} of {num_views} views on average"
    where = f"{distance_mm[chosen] / 1000:.1f} m from the point that the cameras look at"
    if len(ranked) == 1:
        return f"followed the only person: {text}; {where}"
    rest = ", ".join(f"{mean_views[track]:.1f}" for track in ranked if track != chosen)
    others = ", ".join(f"{distance_mm[track] / 1000:.1f} m" for track in ranked if track != chosen)
    reason = "nearly equal, so the nearer one" if num_rivals > 1 else "the most"
    return (
        f"followed person {ranked.index(chosen) + 1} of {len(ranked)}: {text} against {rest} ({reason}); "
        f"{where} against {others}"
    )
