"""Say how good an annotation is without ground truth: coverage, reprojection, constant bones, synchronisation.

Everything a user asks first when the 3D is empty or odd: which joints are missing and why, which camera disagrees,
whether the forearm keeps its length, and whether a view runs ahead of the others.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import BODIES, BODY_KEYPOINTS, JOINTS, RESIDUALS, VIEWS
from assemblyhands_core.data.evaluation_tables import QUALITY
from assemblyhands_core.data.keypoint_rows import rows_of_hands
from assemblyhands_core.data.round_outcomes import KEPT
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.geometry.synchronisation import estimate_synchronisation
from assemblyhands_core.hands.body import ARMS, NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import BONES, FINGERS, HANDS, JOINT_NAMES, WRIST, Hand
from assemblyhands_core.hands.kinematics import bone_lengths_mm
from assemblyhands_core.hands.steadiness import bones_spread_mm, robust_sd
from stages._contract import Context, Stage, StageConfig, Tables

Cell = tuple[str, str, str, float, int]  # table, row, metric, value, n
Floats = npt.NDArray[np.floating[Any]]
REPROJECTION = "reprojection of 2D + triangulation, median (px)"
"""The table of it, by joint and camera; its row `ALL_JOINTS` holds all of them again."""
ALL_JOINTS = "all joints"
_NEAR_MM = 20.0


class MeasureQualityConfig(StageConfig):
    """Parameters of the quality tables."""

    num_sync_frames: int = Field(ge=1)
    max_shift_frames: int = Field(ge=1)
    max_reprojection_px: float = Field(gt=0)


def run(config: MeasureQualityConfig, inputs: Tables, context: Context) -> Tables:
    """Measure one sequence."""
    cells = [
        *_coverage(inputs["joints"]),
        *_agreement(inputs["joints"], inputs["triangulated"]),
        *_wrists(inputs),
        *_reprojection(inputs["residuals"]),
        *_hand_bones(inputs["joints"]),
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
    for side in HANDS:
        reasons = to_numpy(joints["reason"])[_rows_of(joints, side)].ravel()
        names, counts = np.unique(np.where(reasons == "", "valid", reasons).astype(str), return_counts=True)
        for name, count in sorted(zip(names, counts, strict=True), key=lambda pair: -pair[1]):
            yield "joints by outcome (%)", str(name), side, 100.0 * count / reasons.size, int(count)


def _agreement(joints: pa.Table, triangulated: pa.Table) -> Iterator[Cell]:
    """Yield how far the joints are from those of 2D + triangulation, and whose bones are the more constant."""
    if to_numpy(joints["round"]).max(initial=0) == 0:
        return
    place = rows_of_hands(joints, triangulated)
    own_mm, first_mm = joints_or_nan(joints), joints_or_nan(triangulated)[place]
    own_px, first_px = to_numpy(joints["reprojection_px"]), to_numpy(triangulated["reprojection_px"])[place]
    is_kept = pc.starts_with(joints["source"], KEPT).to_numpy(zero_copy_only=False)
    for side in HANDS:
        of_side = _rows_of(joints, side)
        apart_mm = _known(np.linalg.norm(own_mm - first_mm, axis=-1)[of_side])
        table = "agreement with 2D + triangulation"
        yield table, side, "median distance (mm)", _median(apart_mm), len(apart_mm)
        yield table, side, "within 20 mm (%)", _percent(apart_mm <= _NEAR_MM), len(apart_mm)
        yield table, side, "hands kept from an earlier round (%)", _percent(is_kept[of_side]), int(of_side.sum())
        for name, pixels in (("median reprojection (px)", own_px), ("median reprojection before (px)", first_px)):
            yield table, side, name, _median(known := _known(pixels[of_side])), len(known)
        for name, points in (("bones' spread (mm)", own_mm), ("bones' spread before (mm)", first_mm)):
            yield table, side, name, bones_spread_mm(points[of_side]), sum(map(len, _bones_mm(points[of_side])))


def _wrists(inputs: Tables) -> Iterator[Cell]:
    """Yield how often each wrist is there and how well its views agree; the body's wrist beside the hand's."""
    joints, residuals, bodies = inputs["joints"], inputs["residuals"], inputs["bodies"]
    is_looked_at = (to_numpy(bodies["reason"]) != "skipped_frame").all(axis=1)
    for side in HANDS:
        is_there = to_numpy(joints["valid"])[_rows_of(joints, side), WRIST]
        of_side = _rows_of(residuals, side)
        is_inlier = to_numpy(residuals["is_inlier"])[of_side, WRIST]
        error_px = to_numpy(residuals["residual_px"])[of_side, WRIST][is_inlier]
        body_is_there = to_numpy(bodies["valid"])[is_looked_at, ARMS[side].wrist]
        yield "wrist", side, "coverage (%)", _percent(is_there), len(is_there)
        yield "wrist", side, "median reprojection of 2D + triangulation (px)", _median(error_px), len(error_px)
        yield "wrist", side, "coverage of the body's (%)", _percent(body_is_there), len(body_is_there)


def _reprojection(residuals: pa.Table) -> Iterator[Cell]:
    """Yield the median reprojection error of the triangulation's inliers by joint and camera, and over all joints."""
    camera = to_numpy(residuals["camera_id"])
    error_px = np.where(to_numpy(residuals["is_inlier"]), to_numpy(residuals["residual_px"]), np.nan)
    for name in dict.fromkeys(camera):
        of_camera = error_px[camera == name]
        columns = {**{joint: of_camera[:, j] for j, joint in enumerate(JOINT_NAMES)}, ALL_JOINTS: of_camera.ravel()}
        for row, values in columns.items():
            known = _known(values)
            yield REPROJECTION, row, str(name), _median(known), len(known)


def _hand_bones(joints: pa.Table) -> Iterator[Cell]:
    """Yield how long the bones of each finger are and how constant: the mean over its bones of both, robustly."""
    points, finger_of_bone = joints_or_nan(joints), np.array(BONES)[:, 0] // 4
    for side in HANDS:
        of_side = points[_rows_of(joints, side)]
        parts = {finger: finger_of_bone == f for f, finger in enumerate(FINGERS)}
        for row, of_row in {**parts, "all fingers": np.full(len(BONES), True)}.items():
            bones = _bones_mm(of_side, of_row)
            num_lengths = sum(map(len, bones))
            yield "hand bones (mm)", row, f"{side} median", _mean([_median(bone) for bone in bones]), num_lengths
            yield "hand bones (mm)", row, f"{side} spread", _mean([robust_sd(bone) for bone in bones]), num_lengths


def _bones_mm(points_mm: Floats, of_bone: Any = slice(None)) -> list[Floats]:
    """Return the lengths of each bone in hands (G, 21, 3), without bones that are never known."""
    return [known for bone in bone_lengths_mm(points_mm).T[of_bone] if len(known := _known(bone))]


def _forearms(bodies: pa.Table) -> Iterator[Cell]:
    """Yield how long each forearm is and how constant: it should not change."""
    points = to_numpy(bodies["body_world_mm"]).reshape(-1, NUM_BODY_KEYPOINTS, 3).astype(np.float64)
    for side, arm in ARMS.items():
        length_mm = _known(np.linalg.norm(points[:, arm.wrist] - points[:, arm.elbow], axis=1))
        yield "forearm (mm)", side, "mean", _mean(length_mm), len(length_mm)
        sd_mm = float(np.std(length_mm)) if len(length_mm) else float("nan")
        yield "forearm (mm)", side, "sd", sd_mm, len(length_mm)


def _synchronisation(config: MeasureQualityConfig, inputs: Tables) -> Iterator[Cell]:
    """Yield how far each view is off from the others in time, and in where it looks."""
    cameras = valid_cameras(inputs["views"])
    if len(cameras) < 3:
        return
    keypoints_px, confidence = _by_frame_and_view(inputs["body_keypoints"], list(cameras))
    middle = slice(max(0, (len(confidence) - config.num_sync_frames) // 2), None)
    keypoints_px, confidence = (values[middle][: config.num_sync_frames] for values in (keypoints_px, confidence))
    found = estimate_synchronisation(
        keypoints_px,
        confidence,
        list(cameras.values()),
        max_shift=config.max_shift_frames,
        max_reprojection_px=config.max_reprojection_px,
    )
    metrics: Mapping[str, Any] = {
        "late by (frames)": np.where(np.isnan(found.error_best_px), np.nan, found.best_shift),
        "error as recorded (px)": found.error_now_px,
        "error without delay (px)": found.error_best_px,
        "offset right (px)": found.offset_px[:, 0],
        "offset down (px)": found.offset_px[:, 1],
    }
    for view, name in enumerate(cameras):
        for metric, values in metrics.items():
            yield "agreement of views", name, metric, float(values[view]), len(keypoints_px)


def _by_frame_and_view(table: pa.Table, camera_ids: list[str]) -> tuple[Floats, Floats]:
    """Return the body's keypoints (F, V, K, 2) and confidence (F, V, K) over consecutive frames."""
    frame, camera = to_numpy(table["frame"]), to_numpy(table["camera_id"])
    first = int(frame.min(initial=np.iinfo(np.int64).max))
    shape = (int(frame.max(initial=first - 1)) - first + 1, len(camera_ids), NUM_BODY_KEYPOINTS)
    keypoints_px, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    for view, name in enumerate(camera_ids):
        rows = camera == name
        keypoints_px[frame[rows] - first, view] = to_numpy(table["body_px"])[rows].reshape(-1, NUM_BODY_KEYPOINTS, 2)
        confidence[frame[rows] - first, view] = to_numpy(table["confidence"])[rows]
    return keypoints_px, confidence


def _rows_of(table: pa.Table, side: Hand) -> npt.NDArray[np.bool_]:
    return np.asarray(to_numpy(table["hand"]) == side, dtype=np.bool_)


def _known(values: Floats) -> Floats:
    return np.asarray(values[np.isfinite(values)])


def _percent(flags: npt.NDArray[np.bool_]) -> float:
    return 100.0 * _mean(flags)


def _mean(values: Any) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else float("nan")


STAGE = Stage(
    name="measure_quality",
    version=3,
    config=MeasureQualityConfig,
    inputs={
        "views": VIEWS,
        "body_keypoints": BODY_KEYPOINTS,
        "bodies": BODIES,
        "joints": JOINTS,
        "triangulated": JOINTS,
        "residuals": RESIDUALS,
    },
    outputs={"quality": QUALITY},
    run=run,
    shard="sequence",
)
