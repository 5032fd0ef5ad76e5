"""Say how good an annotation is without ground truth: coverage, reprojection, constant bones, synchronisation.

Everything a user asks first when the 3D is empty or odd: which joints are missing and why, which camera disagrees,
whether the forearm keeps its length, and whether a view runs ahead of the others.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import (
    BODIES,
    BODY_KEYPOINTS,
    JOINTS,
    QUALITY,
    RESIDUALS,
    VIEWS,
)
from assemblyhands_core.geometry.synchronisation import estimate_synchronisation
from assemblyhands_core.hands.body import ARMS, NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import HANDS, JOINT_NAMES, WRIST
from stages._contract import Context, Stage, StageConfig, Tables

Cell = tuple[str, str, str, float, int]  # table, row, metric, value, n
Floats = npt.NDArray[np.floating[Any]]


class MeasureQualityConfig(StageConfig):
    """Parameters of the quality tables."""

    max_shift_frames: int = Field(ge=1)
    max_reprojection_px: float = Field(gt=0)


def run(config: MeasureQualityConfig, inputs: Tables, context: Context) -> Tables:
    """Measure one sequence."""
    cells = [
        *_coverage(inputs["joints"]),
        *_wrists(inputs["joints"]),
        *_reprojection(inputs["residuals"]),
        *_forearms(inputs["bodies"]),
        *_synchronisation(config, inputs),
    ]
    rows = [
        {"sequence_id": context.sequence_id, "table": t, "row": r, "metric": m, "value": v, "n": n}
        for t, r, m, v, n in cells
    ]
    return {"quality": QUALITY.from_rows(rows)}


def _coverage(joints: pa.Table) -> Iterator[Cell]:
    """Yield the percentage of joints by outcome, for each hand."""
    hand, reason = to_numpy(joints["hand"]), to_numpy(joints["reason"])
    for side in HANDS:
        reasons = reason[hand == side].ravel()
        names, counts = np.unique(np.where(reasons == "", "valid", reasons).astype(str), return_counts=True)
        for name, count in sorted(zip(names, counts, strict=True), key=lambda pair: -pair[1]):
            yield "joints by outcome (%)", str(name), side, 100.0 * count / reasons.size, int(count)


def _wrists(joints: pa.Table) -> Iterator[Cell]:
    hand = to_numpy(joints["hand"])
    for side in HANDS:
        valid = to_numpy(joints["valid"])[hand == side, WRIST]
        error_px = to_numpy(joints["reprojection_px"])[hand == side, WRIST][valid]
        yield "wrist", side, "coverage (%)", 100.0 * float(np.mean(valid)), len(valid)
        yield "wrist", side, "median reprojection (px)", _median(error_px), len(error_px)


def _reprojection(residuals: pa.Table) -> Iterator[Cell]:
    """Yield the median reprojection error of inliers by joint and camera, and over all joints."""
    camera = to_numpy(residuals["camera_id"])
    error_px = np.where(to_numpy(residuals["is_inlier"]), to_numpy(residuals["residual_px"]), np.nan)
    for name in dict.fromkeys(camera):
        of_camera = error_px[camera == name]
        columns = {**{joint: of_camera[:, j] for j, joint in enumerate(JOINT_NAMES)}, "all joints": of_camera.ravel()}
        for row, values in columns.items():
            known = values[np.isfinite(values)]
            yield "median reprojection of inliers (px)", row, str(name), _median(known), len(known)


def _forearms(bodies: pa.Table) -> Iterator[Cell]:
    """Yield how long each forearm is and how constant: it should not change."""
    points = to_numpy(bodies["body_world_mm"]).reshape(-1, NUM_BODY_KEYPOINTS, 3)
    for side, arm in ARMS.items():
        length = np.linalg.norm(points[:, arm.wrist] - points[:, arm.elbow], axis=1)
        known = length[np.isfinite(length)]
        for metric, value in (("mean", known.mean()), ("sd", known.std())) if len(known) else ():
            yield "forearm (mm)", side, metric, float(value), len(known)


def _synchronisation(config: MeasureQualityConfig, inputs: Tables) -> Iterator[Cell]:
    """Yield how far each view is off from the others in time, and in where it looks."""
    cameras = valid_cameras(inputs["views"])
    if len(cameras) < 3:
        return
    keypoints_px, confidence = _by_frame_and_view(inputs["body_keypoints"], list(cameras))
    found = estimate_synchronisation(
        keypoints_px,
        confidence,
        list(cameras.values()),
        max_shift=config.max_shift_frames,
        max_reprojection_px=config.max_reprojection_px,
    )
    metrics: Mapping[str, Any] = {
        "shift (frames)": found.best_shift,
        "error as recorded (px)": found.error_now_px,
        "error at that shift (px)": found.error_best_px,
        "offset right (px)": found.offset_px[:, 0],
        "offset down (px)": found.offset_px[:, 1],
    }
    for view, name in enumerate(cameras):
        for metric, values in metrics.items():
            yield "agreement of views", name, metric, float(values[view]), len(keypoints_px)


def _by_frame_and_view(table: pa.Table, camera_ids: list[str]) -> tuple[Floats, Floats]:
    """Return the body's keypoints (F, V, K, 2) and confidence (F, V, K)."""
    frame = pd.factorize(to_numpy(table["frame"]), sort=True)[0]
    view = pd.Index(camera_ids).get_indexer(pd.Index(to_numpy(table["camera_id"])))
    shape = (int(frame.max(initial=-1)) + 1, len(camera_ids), NUM_BODY_KEYPOINTS)
    keypoints_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    is_used = view >= 0
    keypoints_px[frame[is_used], view[is_used]] = to_numpy(table["body_px"]).reshape(-1, NUM_BODY_KEYPOINTS, 2)[is_used]
    confidence[frame[is_used], view[is_used]] = to_numpy(table["confidence"])[is_used]
    return keypoints_px, confidence


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else float("nan")


STAGE = Stage(
    name="measure_quality",
    version=1,
    config=MeasureQualityConfig,
    inputs={
        "views": VIEWS,
        "body_keypoints": BODY_KEYPOINTS,
        "bodies": BODIES,
        "joints": JOINTS,
        "residuals": RESIDUALS,
    },
    outputs={"quality": QUALITY},
    run=run,
    shard="sequence",
)
