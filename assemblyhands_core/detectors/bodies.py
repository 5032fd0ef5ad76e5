"""Run a body detector over some frames of all views."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int, Shaped

from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.detectors.base import BodyDetections, BodyDetector, ImageRGB
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS


@dataclass(frozen=True, eq=False)
class BodiesInViews:
    """The persons in some frames of all views.

    Attributes:
        keypoints_px: COCO-17 order, pixels of the view's video; NaN = missing.
        confidence: in 0..1; 0 = missing.
        num_persons: how many were found.
        reason: texts, why nobody was found: ``skipped_frame`` (not looked at), ``missing_frame`` (the view lacks it),
            ``no_detection``; empty where somebody was.
    """

    keypoints_px: Float64[np.ndarray, "frame view detection keypoint=17 2"]
    confidence: Float64[np.ndarray, "frame view detection keypoint=17"]
    num_persons: Int[np.ndarray, "frame view"]
    reason: Shaped[np.ndarray, "frame view"]


def detect_bodies(
    detector: BodyDetector,
    views: Sequence[Mapping[str, Any]],
    frames: range,
    *,
    every_nth_frame: int = 1,
    max_image_side_px: int | None = None,
    num_threads: int = 1,
) -> BodiesInViews:
    """Find the persons in every n-th frame of all views, and in the last one so that no gap stays open.

    Args:
        detector: the detector.
        views: rows of the table ``views``.
        frames: consecutive frame numbers.
        every_nth_frame: frames between are left without persons.
        max_image_side_px: images are decoded at most this large; keypoints are in full-size pixels all the same.
        num_threads: decoder threads.

    Returns:
        The persons; a frame that a view lacks is one without persons.
    """
    wanted = frames[::every_nth_frame]
    parts = [wanted] if not frames or frames[-1] in wanted else [wanted, frames[-1:]]
    nobody = BodyDetections.none()
    by_view = [[nobody] * len(frames) for _ in views]
    reason = np.full((len(frames), len(views)), "skipped_frame", dtype=object)
    for part in parts:
        reason[part.start - frames.start : part.stop - frames.start : part.step] = "missing_frame"
        for v, view in enumerate(views):
            for frame, image in _images(detector, view, part, max_image_side_px, num_threads):
                found = _at_full_size(detector.detect(image, view["camera_id"], frame), image, view)
                by_view[v][frame - frames.start] = found
                reason[frame - frames.start, v] = "" if len(found.confidence) else "no_detection"
    return _stack(by_view, reason)


def _images(
    detector: BodyDetector, view: Mapping[str, Any], wanted: range, max_side_px: int | None, num_threads: int
) -> Iterator[tuple[int, ImageRGB | None]]:
    if not detector.needs_image:
        return ((frame, None) for frame in wanted)
    reader = VideoReader(view["video_file"], threads=num_threads)
    return reader.frames(wanted.start, len(wanted), wanted.step, max_side_px, on_missing="skip")


def _at_full_size(found: BodyDetections, image: ImageRGB | None, view: Mapping[str, Any]) -> BodyDetections:
    if image is None:
        return found
    scale = np.array([view["width_px"] / image.shape[1], view["height_px"] / image.shape[0]])
    return BodyDetections((found.keypoints_px + 0.5) * scale - 0.5, found.confidence)


def _stack(by_view: Sequence[Sequence[BodyDetections]], reason: Shaped[np.ndarray, "frame view"]) -> BodiesInViews:
    num_persons = np.zeros(reason.shape, dtype=np.int64)
    for v, frames in enumerate(by_view):
        num_persons[:, v] = [len(found.confidence) for found in frames]
    shape = (*reason.shape, max(1, int(num_persons.max(initial=0))), NUM_BODY_KEYPOINTS)
    keypoints_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    for v, frames in enumerate(by_view):
        for f, found in enumerate(frames):
            keypoints_px[f, v, : num_persons[f, v]] = found.keypoints_px
            confidence[f, v, : num_persons[f, v]] = found.confidence
    return BodiesInViews(keypoints_px, confidence, num_persons, reason)
