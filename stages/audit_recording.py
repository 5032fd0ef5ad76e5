"""Look a recording over before hours are spent on it: files, sizes, bodies seen, synchronisation.

This is what ``make doctor`` prints. Bodies are detected in a short run of frames only.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import AUDIT, VIEWS
from assemblyhands_core.detectors.bodies import BodiesInViews, detect_bodies
from assemblyhands_core.detectors.followed_person import follow_in_views
from assemblyhands_core.detectors.registry import create_body_detector
from assemblyhands_core.geometry.synchronisation import Synchronisation, estimate_synchronisation
from stages._contract import Context, Stage, Tables
from stages._detector_config import DetectorConfig, detector_externals

Finding = tuple[str, str, str, float, str]  # check, camera, level, value, note
_CANNOT_BE_TOLD = "cannot be told: that takes two other views that see the person move"


class AuditRecordingConfig(DetectorConfig):
    """Parameters of the audit."""

    keypoints_file = "bodies.parquet"
    num_frames: int = Field(ge=1)
    max_image_side_px: int = Field(ge=128)
    max_persons: int = Field(ge=1, le=8)
    association_px: float = Field(gt=0)
    max_shift_frames: int = Field(ge=1)
    min_seen_fraction: float = Field(ge=0, le=1)
    sync_gain: float = Field(gt=0, lt=1)
    max_offset_px: float = Field(gt=0)


def run(config: AuditRecordingConfig, inputs: Tables, context: Context) -> Tables:
    """Audit one sequence."""
    views = inputs["views"].to_pylist()
    findings = [*_files(views), *_bodies(config, inputs, context)]
    rows = [
        {"sequence_id": context.sequence_id, "check": c, "camera_id": camera, "level": level, "value": v, "note": note}
        for c, camera, level, v, note in findings
    ]
    return {"audit": AUDIT.from_rows(rows)}


def _files(views: list[dict[str, Any]]) -> Iterator[Finding]:
    """Yield what ingest found in each view's file."""
    for view in views:
        size = f"{view['width_px']}×{view['height_px']}, {view['num_frames']} frames at {view['rate_hz']:.4g} Hz"
        note = ". ".join(part for part in (size if view["num_frames"] else "", view["note"]) if part)
        level = "error" if not view["valid"] else "warning" if view["note"] else "ok"
        reason = "" if view["valid"] else f"{view['reason']}: this view is left out. "
        yield "file", view["camera_id"], level, float(view["num_frames"]), reason + note


def _bodies(config: AuditRecordingConfig, inputs: Tables, context: Context) -> Iterator[Finding]:
    """Yield how often each view sees the followed person, and whether it runs with the others."""
    cameras = valid_cameras(inputs["views"])
    found = _detect(config, [view for view in inputs["views"].to_pylist() if view["valid"]], context)
    person = follow_in_views(
        found,
        list(cameras.values()),
        max_reprojection_px=config.association_px,
        max_persons=config.max_persons,
    )
    seen = person.is_seen.mean(axis=0)
    yield "person", "all", "ok" if seen.any() else "error", float(seen.mean()), person.sentence
    for name, share in zip(cameras, seen, strict=True):
        level = "ok" if share >= config.min_seen_fraction else "warning"
        yield "person seen", name, level, float(share), f"agrees with the other views in {share:.0%} of the frames"
    sync = estimate_synchronisation(
        person.keypoints_px,
        person.confidence,
        list(cameras.values()),
        max_shift=config.max_shift_frames,
        max_reprojection_px=config.association_px,
    )
    for view, name in enumerate(cameras):
        yield from _agreement(config, name, sync, view)


def _detect(config: AuditRecordingConfig, views: list[dict[str, Any]], context: Context) -> BodiesInViews:
    """Detect bodies in a run of frames around the middle of the recording."""
    num_frames = max(view["num_frames"] for view in views)
    length = min(config.num_frames, num_frames)
    first = (num_frames - length) // 2
    return detect_bodies(
        create_body_detector(config.detector, **config.detector_options(context.sequence_id)),
        views,
        range(first, first + length),
        max_image_side_px=config.max_image_side_px,
        num_threads=context.num_threads,
    )


def _agreement(config: AuditRecordingConfig, name: str, sync: Synchronisation, view: int) -> Iterator[Finding]:
    """Yield whether one view runs in step with the others, and looks where its calibration says."""
    shift, now, best = int(sync.best_shift[view]), sync.error_now_px[view], sync.error_best_px[view]
    if np.isnan(now):
        yield "synchronisation", name, "warning", float("nan"), _CANNOT_BE_TOLD
        return
    if shift and best < config.sync_gain * now:
        note = f"fits the others better when shifted by {-shift:+d} frames ({now:.1f} → {best:.1f} px)"
        yield "synchronisation", name, "warning", float(shift), note
    else:
        yield "synchronisation", name, "ok", 0.0, f"in step with the others ({now:.1f} px)"
    right, down = (float(offset) for offset in sync.offset_px[view])
    distance = math.hypot(right, down)
    is_off = distance > config.max_offset_px
    note = f"sees everything {round(right):+d} px right, {round(down):+d} px down of where the other views do"
    remedy = "; was it moved or zoomed after the calibration?" if is_off else ""
    yield "calibration", name, "warning" if is_off else "ok", distance, note + remedy


STAGE = Stage(
    name="audit_recording",
    version=1,
    config=AuditRecordingConfig,
    inputs={"views": VIEWS},
    outputs={"audit": AUDIT},
    run=run,
    shard="sequence",
    externals=detector_externals,
)
