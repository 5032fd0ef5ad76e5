"""Find both hands in all views from the body's skeleton (paper, supplement, "Processing of exocentric images").

2D body keypoints of every view → one person, the same in all views → robust 3D → virtual hand centre a third of the
forearm beyond the wrist → one square box per view around its projection, of a metric size. So boxes agree across the
views, and which hand is right follows from the skeleton, not from the look of the hand.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field, JsonValue

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import (
    BODIES,
    BODY_KEYPOINTS,
    CHUNKS,
    FOLLOWED,
    HAND_BOXES,
    RECTIFIED_VIEWS,
    VIEWS,
)
from assemblyhands_core.data.outcomes import outcome_columns
from assemblyhands_core.detectors.base import BODY_MIRROR
from assemblyhands_core.detectors.bodies import detect_bodies
from assemblyhands_core.detectors.options import detector_options
from assemblyhands_core.detectors.registry import create_body_detector, fingerprint
from assemblyhands_core.geometry.association import associate_persons, follow_person
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.interpolation import fill_gaps
from assemblyhands_core.geometry.triangulation import Triangulation, triangulate
from assemblyhands_core.hands.body import ARMS, NUM_BODY_KEYPOINTS, hand_center
from assemblyhands_core.hands.joints import HANDS
from stages._contract import Context, Stage, StageConfig, Tables

Floats = npt.NDArray[np.floating[Any]]
Texts = npt.NDArray[Any]


class DetectHandsConfig(StageConfig):
    """Parameters of hand detection."""

    detector: str
    options: Mapping[str, Mapping[str, JsonValue]]
    every_nth_frame: int = Field(ge=1)
    max_image_side_px: int = Field(ge=128)
    max_persons: int = Field(ge=1, le=8)
    association_px: float = Field(gt=0)
    max_reprojection_px: float = Field(gt=0)
    max_gap_frames: int = Field(ge=0)
    hand_radius_mm: float = Field(gt=0)


def run(config: DetectHandsConfig, inputs: Tables, context: Context) -> Tables:
    """Detect the hands of one chunk of frames."""
    chunk = inputs["chunks"].to_pylist()[0]
    frames = np.arange(chunk["first_frame"], chunk["first_frame"] + chunk["num_frames"])
    cameras = valid_cameras(inputs["views"])
    views = inputs["views"].to_pylist()
    found = detect_bodies(
        create_body_detector(config.detector, **_options(config, context.sequence_id)),
        [view for view in views if view["valid"]],
        range(frames[0], frames[-1] + 1),
        every_nth_frame=config.every_nth_frame,
        max_image_side_px=config.max_image_side_px,
        num_threads=context.num_threads,
    )
    persons = associate_persons(
        found.keypoints_px,
        found.confidence,
        list(cameras.values()),
        max_reprojection_px=config.association_px,
        max_persons=config.max_persons,
        mirror=BODY_MIRROR,
    )
    followed = follow_person(persons, list(cameras.values()), mirror=BODY_MIRROR)
    body_px, body_confidence = followed.select(found.keypoints_px, found.confidence, BODY_MIRROR)
    bodies = _triangulate(config, body_px, body_confidence, list(cameras.values()))
    return {
        "hand_boxes": _hand_boxes(
            config, chunk["sequence_id"], frames, bodies.points_world_mm, inputs["rectified_views"]
        ),
        "body_keypoints": _body_keypoints(views, list(cameras), frames, body_px, body_confidence, found.num_persons),
        "bodies": _bodies(chunk["sequence_id"], frames, bodies),
        "followed": FOLLOWED.from_rows(
            [
                {
                    "sequence_id": chunk["sequence_id"],
                    "first_frame": chunk["first_frame"],
                    "num_persons": int((persons.num_views > 0).sum(axis=1).max(initial=0)),
                    "note": followed.sentence,
                }
            ]
        ),
    }


def _triangulate(
    config: DetectHandsConfig, body_px: Floats, confidence: Floats, cameras: Sequence[Camera]
) -> Triangulation:
    """Triangulate (F, V, K, 2) keypoints; points are frame-major, (F * K)."""
    by_point = body_px.swapaxes(1, 2).reshape(-1, len(cameras), 2)
    weights = confidence.swapaxes(1, 2).reshape(-1, len(cameras))
    return triangulate(by_point, cameras, weights, max_reprojection_px=config.max_reprojection_px)


def _hand_boxes(
    config: DetectHandsConfig, sequence_id: str, frames: npt.NDArray[np.int64], body_mm: Floats, rectified: pa.Table
) -> pa.Table:
    """Return a box per frame, hand and view around the projected hand centre."""
    center_mm, is_filled = _hand_centers(config, body_mm.reshape(len(frames), NUM_BODY_KEYPOINTS, 3))
    cameras = valid_cameras(rectified)
    reason_of_view = dict(zip(*(rectified.column(name).to_pylist() for name in ("camera_id", "reason")), strict=True))
    columns = [_boxes_in_view(config, center_mm, cameras.get(name), reason_of_view[name]) for name in reason_of_view]
    num_views, shape = len(columns), (len(frames), len(HANDS), len(columns))
    center_px, side_px, reason = (np.stack([part[i] for part in columns], axis=2) for i in range(3))
    source = np.where(is_filled, "interpolated", "detected")
    return HAND_BOXES.build(
        {
            "sequence_id": [sequence_id] * int(np.prod(shape)),
            "frame": np.repeat(frames, len(HANDS) * num_views),
            "hand": list(np.tile(np.repeat(HANDS, num_views), len(frames))),
            "camera_id": list(reason_of_view) * (len(frames) * len(HANDS)),
            "hand_center_world_mm": np.repeat(center_mm.reshape(-1, 3), num_views, axis=0),
            "center_rectified_px": center_px.reshape(-1, 2),
            "side_px": side_px.ravel(),
            "source": list(np.repeat(source.ravel(), num_views)),
            "valid": reason.ravel() == "",
            "reason": list(reason.ravel()),
        }
    )


def _hand_centers(config: DetectHandsConfig, body_mm: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Return (F, H, 3) hand centres, and (F, H) where a gap between detections was filled."""
    arms = np.stack([hand_center(body_mm[:, ARMS[hand].elbow], body_mm[:, ARMS[hand].wrist]) for hand in HANDS], axis=1)
    return fill_gaps(arms, config.max_gap_frames)


def _boxes_in_view(
    config: DetectHandsConfig, center_mm: Floats, camera: Camera | None, view_reason: str
) -> tuple[Floats, Floats, Texts]:
    """Return (F, H, 2) box centres, (F, H) sides in rectified pixels, and (F, H) reasons, one view's."""
    shape = center_mm.shape[:2]
    if camera is None:
        return np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.full(shape, view_reason, dtype=object)
    center_px, depth_mm = camera.project(center_mm), camera.depth_mm(center_mm)
    reason: Texts = np.full(shape, "", dtype=object)
    reason[~camera.contains(center_px)] = "outside_view"
    reason[depth_mm <= 0] = "behind_camera"
    reason[np.isnan(center_mm).any(axis=-1)] = "no_detection"
    side_px = np.where(
        depth_mm > 0, 2 * config.hand_radius_mm * camera.fx_px / np.where(depth_mm > 0, depth_mm, 1), np.nan
    )
    return center_px, side_px, reason


def _body_keypoints(
    views: Sequence[Mapping[str, Any]],
    camera_ids: Sequence[str],
    frames: npt.NDArray[np.int64],
    body_px: Floats,
    confidence: Floats,
    num_persons: npt.NDArray[np.int64],
) -> pa.Table:
    """Return the followed person's keypoints, a row per frame and view; views that cannot be used keep their reason."""
    place = {camera_id: v for v, camera_id in enumerate(camera_ids)}
    tables = []
    for view in views:
        v = place.get(view["camera_id"])
        points = np.full((len(frames), NUM_BODY_KEYPOINTS, 2), np.nan) if v is None else body_px[:, v]
        weights = np.zeros((len(frames), NUM_BODY_KEYPOINTS)) if v is None else confidence[:, v]
        is_seen = (weights > 0).any(axis=1)
        columns = {
            "sequence_id": [view["sequence_id"]] * len(frames),
            "frame": frames,
            "camera_id": [view["camera_id"]] * len(frames),
            "body_px": points,
            "confidence": weights,
            "num_persons": np.zeros(len(frames)) if v is None else num_persons[:, v],
            "valid": is_seen,
            "reason": list(np.where(is_seen, "", view["reason"] or "no_detection")),
        }
        tables.append(BODY_KEYPOINTS.build(columns))
    return pa.concat_tables(tables)


def _bodies(sequence_id: str, frames: npt.NDArray[np.int64], found: Triangulation) -> pa.Table:
    return BODIES.build(
        {
            "sequence_id": [sequence_id] * len(frames),
            "frame": frames,
            "body_world_mm": found.points_world_mm.reshape(len(frames), -1),
            **outcome_columns(found, len(frames)),
        }
    )


def _options(config: DetectHandsConfig, sequence_id: str) -> dict[str, Any]:
    return detector_options(config.options, config.detector, sequence_id)


def _externals(config: DetectHandsConfig, sequence_id: str) -> Mapping[str, str]:
    return fingerprint(config.detector, _options(config, sequence_id))


STAGE = Stage(
    name="detect_hands",
    version=1,
    config=DetectHandsConfig,
    inputs={"chunks": CHUNKS, "views": VIEWS, "rectified_views": RECTIFIED_VIEWS},
    outputs={"hand_boxes": HAND_BOXES, "body_keypoints": BODY_KEYPOINTS, "bodies": BODIES, "followed": FOLLOWED},
    run=run,
    shard="chunk",
    externals=_externals,
)
