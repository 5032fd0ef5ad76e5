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
from pydantic import Field, ValidationInfo, field_validator

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
from assemblyhands_core.detectors.bodies import detect_bodies
from assemblyhands_core.detectors.followed_person import PersonInViews, follow_in_views
from assemblyhands_core.detectors.registry import create_body_detector
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.interpolation import fill_gaps
from assemblyhands_core.geometry.triangulation import Triangulation, triangulate
from assemblyhands_core.hands.body import ARMS, NUM_BODY_KEYPOINTS, hand_center
from assemblyhands_core.hands.joints import HANDS
from stages._contract import Context, Stage, Tables
from stages._detector_config import DetectorConfig, detector_externals

Floats = npt.NDArray[np.floating[Any]]
Counts = npt.NDArray[np.int64]
Texts = npt.NDArray[np.object_]


class DetectHandsConfig(DetectorConfig):
    """Parameters of hand detection."""

    keypoints_file = "bodies.parquet"
    every_nth_frame: int = Field(ge=1)
    max_image_side_px: int = Field(ge=128)
    max_persons: int = Field(ge=1, le=8)
    association_px: float = Field(gt=0)
    max_reprojection_px: float = Field(gt=0)
    max_gap_frames: int = Field(ge=0)
    hand_radius_mm: float = Field(gt=0)

    @field_validator("max_gap_frames")
    @classmethod
    def _fills_what_is_skipped(cls, max_gap_frames: int, info: ValidationInfo) -> int:
        if max_gap_frames < info.data.get("every_nth_frame", 1) - 1:
            raise ValueError("every_nth_frame leaves longer gaps, which would stay empty")
        return max_gap_frames


def run(config: DetectHandsConfig, inputs: Tables, context: Context) -> Tables:
    """Detect the hands of one chunk of frames."""
    chunk = inputs["chunks"].to_pylist()[0]
    frames = range(chunk["first_frame"], chunk["first_frame"] + chunk["num_frames"])
    cameras = valid_cameras(inputs["views"])
    found = detect_bodies(
        create_body_detector(config.detector, **config.detector_options(context.sequence_id)),
        [view for view in inputs["views"].to_pylist() if view["valid"]],
        frames,
        every_nth_frame=config.every_nth_frame,
        max_image_side_px=config.max_image_side_px,
        num_threads=context.num_threads,
    )
    person = follow_in_views(
        found,
        list(cameras.values()),
        max_reprojection_px=config.association_px,
        max_persons=config.max_persons,
    )
    bodies = _triangulate(config, person, list(cameras.values()))
    return {
        "hand_boxes": _hand_boxes(config, frames, bodies.points_world_mm, inputs["rectified_views"], context),
        "body_keypoints": _body_keypoints(inputs["views"], list(cameras), frames, person, found.num_persons),
        "bodies": _bodies(frames, bodies, person, context),
        "followed": FOLLOWED.from_rows([_followed(chunk, person)]),
    }


def _triangulate(config: DetectHandsConfig, person: PersonInViews, cameras: Sequence[Camera]) -> Triangulation:
    """Triangulate the person's keypoints; points are frame-major, (F * K)."""
    by_point = person.keypoints_px.swapaxes(1, 2).reshape(-1, len(cameras), 2)
    weights = person.confidence.swapaxes(1, 2).reshape(-1, len(cameras))
    return triangulate(by_point, cameras, weights, max_reprojection_px=config.max_reprojection_px)


def _hand_boxes(
    config: DetectHandsConfig, frames: range, body_mm: Floats, rectified: pa.Table, context: Context
) -> pa.Table:
    """Return a box per frame, hand and view around the projected hand centre."""
    center_mm, source = _hand_centers(config, body_mm.reshape(len(frames), NUM_BODY_KEYPOINTS, 3))
    cameras = valid_cameras(rectified)
    reason_of_view = dict(zip(*(rectified.column(name).to_pylist() for name in ("camera_id", "reason")), strict=True))
    by_view = [_boxes_in_view(config, center_mm, cameras.get(name), reason_of_view[name]) for name in reason_of_view]
    center_px, side_px, reason = (np.stack([boxes[i] for boxes in by_view], axis=2) for i in range(3))
    num_views, num_rows = len(by_view), reason.size
    return HAND_BOXES.build(
        {
            "sequence_id": [context.sequence_id] * num_rows,
            "frame": np.repeat(np.asarray(frames, dtype=np.int64), len(HANDS) * num_views),
            "hand": np.tile(np.repeat(np.array(HANDS, dtype=object), num_views), len(frames)),
            "camera_id": list(reason_of_view) * (len(frames) * len(HANDS)),
            "hand_center_world_mm": np.repeat(center_mm.reshape(-1, 3), num_views, axis=0),
            "center_rectified_px": center_px.reshape(-1, 2),
            "side_px": side_px.ravel(),
            "source": np.repeat(source.ravel(), num_views),
            "valid": reason.ravel() == "",
            "reason": reason.ravel(),
        }
    )


def _hand_centers(config: DetectHandsConfig, body_mm: Floats) -> tuple[Floats, Texts]:
    """Return (F, H, 3) hand centres, and (F, H) their sources: detected, interpolated, or none."""
    arms = np.stack([hand_center(body_mm[:, ARMS[hand].elbow], body_mm[:, ARMS[hand].wrist]) for hand in HANDS], axis=1)
    centers, is_filled = fill_gaps(arms, config.max_gap_frames)
    is_known = np.isfinite(centers).all(axis=-1)
    return centers, np.where(is_filled, "interpolated", np.where(is_known, "detected", "")).astype(object)


def _boxes_in_view(
    config: DetectHandsConfig, center_mm: Floats, camera: Camera | None, view_reason: str
) -> tuple[Floats, Floats, Texts]:
    """Return (F, H, 2) box centres, (F, H) sides in rectified pixels, and (F, H) reasons why there is none."""
    shape = center_mm.shape[:2]
    if camera is None:
        return np.full((*shape, 2), np.nan), np.full(shape, np.nan), np.full(shape, view_reason, dtype=object)
    center_px, depth_mm = camera.project(center_mm), camera.depth_mm(center_mm)
    reason: Texts = np.full(shape, "", dtype=object)
    reason[~camera.contains(center_px)] = "outside_view"
    reason[depth_mm <= 0] = "behind_camera"
    reason[np.isnan(depth_mm)] = "no_detection"
    is_valid = reason == ""
    side_px = 2 * config.hand_radius_mm * camera.fx_px / np.where(is_valid, depth_mm, np.nan)
    return np.where(is_valid[..., None], center_px, np.nan), side_px, reason


def _body_keypoints(
    views: pa.Table, camera_ids: Sequence[str], frames: range, person: PersonInViews, num_persons: Counts
) -> pa.Table:
    """Return the followed person's keypoints, a row per view and frame; views that cannot be used keep their reason."""
    tables = []
    for view in views.select(["sequence_id", "camera_id", "valid", "reason"]).to_pylist():
        v = camera_ids.index(view["camera_id"]) if view["valid"] else None
        shape = (len(frames), NUM_BODY_KEYPOINTS)
        reason = np.full(len(frames), view["reason"], dtype=object) if v is None else person.reason[:, v]
        columns = {
            "sequence_id": [view["sequence_id"]] * len(frames),
            "frame": np.asarray(frames, dtype=np.int64),
            "camera_id": [view["camera_id"]] * len(frames),
            "body_px": np.full((*shape, 2), np.nan) if v is None else person.keypoints_px[:, v],
            "confidence": np.zeros(shape) if v is None else person.confidence[:, v],
            "num_persons": np.zeros(len(frames), dtype=np.int8) if v is None else num_persons[:, v],
            "valid": reason == "",
            "reason": reason,
        }
        tables.append(BODY_KEYPOINTS.build(columns))
    return pa.concat_tables(tables)


def _bodies(frames: range, found: Triangulation, person: PersonInViews, context: Context) -> pa.Table:
    """Return the person's body in 3D, a row per frame; frames that no view was looked at in say so."""
    outcome = outcome_columns(found, NUM_BODY_KEYPOINTS)
    outcome["reason"][(person.reason == "skipped_frame").all(axis=1)] = "skipped_frame"
    return BODIES.build(
        {
            "sequence_id": [context.sequence_id] * len(frames),
            "frame": np.asarray(frames, dtype=np.int64),
            "body_world_mm": found.points_world_mm.reshape(-1, 3 * NUM_BODY_KEYPOINTS),
            **outcome,
        }
    )


def _followed(chunk: Mapping[str, Any], person: PersonInViews) -> dict[str, Any]:
    return {
        "sequence_id": chunk["sequence_id"],
        "first_frame": chunk["first_frame"],
        "num_persons": person.num_persons,
        "note": person.sentence,
    }


STAGE = Stage(
    name="detect_hands",
    version=1,
    config=DetectHandsConfig,
    inputs={"chunks": CHUNKS, "views": VIEWS, "rectified_views": RECTIFIED_VIEWS},
    outputs={"hand_boxes": HAND_BOXES, "body_keypoints": BODY_KEYPOINTS, "bodies": BODIES, "followed": FOLLOWED},
    run=run,
    shard="chunk",
    externals=detector_externals,
)
