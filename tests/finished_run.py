"""What a run leaves in its folder: evaluations of errors that a test gives, and rounds of one made-up hand."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from files_beside import files_beside

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CROPS, HAND_BOXES, JOINTS, KEYPOINTS, RECTIFIED_VIEWS, ROUNDS, VIEWS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.evaluation_tables import ERRORS, EVALUATION
from assemblyhands_core.data.tables import TableSpec, write_parquet
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.metrics.annotation import Cell, evaluate_annotation
from assemblyhands_core.metrics.egocentric import evaluate_egocentric
from assemblyhands_core.metrics.verbs import VerbEvaluation, evaluate_verbs
from stages.evaluate import EvaluateConfig

CONFIG: Final = EvaluateConfig(low_occlusion=0.4, high_occlusion=0.6, block_frames=2, num_resamples=100, seed=0)
CAMERA: Final = Camera("front", 640, 480, 1000.0, 1000.0, 319.5, 239.5, Pinhole(), np.eye(4))
BOX_SIDE_PX: Final = 120.0


def write_evaluation(run: Path, sequence_id: str, errors: pa.Table) -> None:
    """Write what the nodes ``evaluation_<number>`` say, one for each method by name, "R..." after digits."""
    for node, of_method in write_errors(run, sequence_id, errors).items():
        cells = evaluate_annotation(of_method, (CONFIG.low_occlusion, CONFIG.high_occlusion), CONFIG.resampling)
        metrics = EVALUATION.from_rows([{"sequence_id": sequence_id, **cell._asdict()} for cell in cells])
        write_table(run / node / "metrics" / f"{sequence_id}.parquet", EVALUATION, metrics)


def write_errors(run: Path, sequence_id: str, errors: pa.Table) -> dict[str, pa.Table]:
    """Write the errors that these nodes found, and return them by node."""
    by_node = {}
    for number, method in enumerate(sorted(set(errors["method"].to_pylist()))):
        node = f"evaluation_{number}" if method[0] in "2R" else "evaluation_bound"
        by_node[node] = errors.filter(pc.equal(errors["method"], method))
        write_table(run / node / "errors" / f"{sequence_id}.parquet", ERRORS, by_node[node])
    return by_node


def write_rounds(run: Path, sequence_id: str, chunk: int, x_mm: Sequence[Sequence[float]]) -> None:
    """Write the rounds of one chunk: where the right hand is, (frame, round), 1 m before the camera.

    Its joints are the corners of an upright square of 40 mm; frames count from ten times the chunk. The detected box is
    around the picture's middle, like the stored crop, twice its size.
    """
    frames = [10 * chunk + index for index in range(len(x_mm))]
    hands = [{"sequence_id": sequence_id, "frame": frame, "hand": "right"} for frame in frames]
    file = f"{sequence_id}.{chunk:05}.parquet"
    for number, places in enumerate(zip(*x_mm, strict=True)):
        joints = [hand | _joints(x, number) for hand, x in zip(hands, places, strict=True)]
        write_table(run / f"round_{number}" / "joints" / file, JOINTS, JOINTS.from_rows(joints))
        if number:
            rounds = ROUNDS.from_rows([hand | _round(number) for hand in hands])
            write_table(run / f"round_{number}" / "rounds" / file, ROUNDS, rounds)
    boxes = HAND_BOXES.from_rows([hand | _box() for hand in hands])
    write_table(run / "detect_hands" / "hand_boxes" / file, HAND_BOXES, boxes)
    write_table(run / "crop_hands" / "crops" / file, CROPS, CROPS.from_rows([hand | _crop() for hand in hands]))
    views = RECTIFIED_VIEWS.from_rows([{"sequence_id": sequence_id} | _rectified()])
    write_table(run / "undistort" / "rectified_views" / f"{sequence_id}.parquet", RECTIFIED_VIEWS, views)


def write_keypoints(run: Path, sequence_id: str, chunk: int, num_frames: int, video: str = "") -> None:
    """Write the 2D keypoints of one chunk, as of joints of `write_rounds` at x = 0; a second view is dark."""
    names = [{"sequence_id": sequence_id, "frame": 10 * chunk + index, "hand": "right"} for index in range(num_frames)]
    corners = 20.0 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])[np.arange(21) % 4] + (319.5, 239.5)
    seen = {"keypoints_px": corners.ravel(), "confidence": [1.0] * 21, "source": "", "valid": True, "reason": ""}
    keypoints = KEYPOINTS.from_rows([name | {"camera_id": CAMERA.camera_id} | seen for name in names])
    write_table(run / "detect_keypoints" / "keypoints" / f"{sequence_id}.{chunk:05}.parquet", KEYPOINTS, keypoints)
    view = {"video_file": video, "video_sha256": "", "num_frames": 99, "rate_hz": 30.0, "image_fit": "", "note": ""}
    rows = [
        {"camera_id": CAMERA.camera_id, **view, **camera_to_row(CAMERA), "valid": True, "reason": ""},
        {"camera_id": "<b>dark</b>", **view, **missing_camera_row(), "valid": False, "reason": "missing_video"},
    ]
    views = VIEWS.from_rows([{"sequence_id": sequence_id} | row for row in rows])
    write_table(run / "ingest" / "views" / f"{sequence_id}.parquet", VIEWS, views)


def write_verb_table(run: Path, node: str) -> None:
    """Write a table of verbs: our annotation tells three of four segments right, SVEgoNet two."""
    said = {"annotation": ("pick up", "pick up", "screw", "pick up"), "svegonet": ("pick up", "screw", "screw", "")}
    rows = [
        {
            "sequence_id": "a",
            "segment": number,
            "source": source,
            "predicted": predicted,
            "coverage": 100.0,
            "verb": ("pick up", "pick up", "screw", "screw")[number],
            "confidence": 0.5,
            "pose_error_mm": 7.0,
        }
        for source, all_said in said.items()
        for number, predicted in enumerate(all_said)
    ]
    evaluation = VerbEvaluation(("pick up", "screw"), "annotation", "recording", 100, 0)
    _write_metrics(run / node, evaluate_verbs(pa.Table.from_pylist(rows), evaluation))


def write_ego_table(run: Path, node: str, errors: pa.Table) -> None:
    """Write an egocentric network's table of rows of `EGO_ERRORS`."""
    _write_metrics(run / node, evaluate_egocentric(errors, CONFIG.resampling))


def _write_metrics(node: Path, cells: Sequence[Cell]) -> None:
    metrics = EVALUATION.from_rows([{"sequence_id": "all", **cell._asdict()} for cell in cells])
    write_table(node / "metrics" / "all.parquet", EVALUATION, metrics)
    (node / "manifest.json").write_text(json.dumps({"stage": "tabulate", "tables": ["metrics"], "shards": {}}))


def write_table(path: Path, spec: TableSpec, table: pa.Table) -> None:
    """Write a table where a run would have it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_parquet(path, files_beside(table, path.parent), spec, {})


def _joints(x_mm: float, number: int) -> dict[str, Any]:
    corners = 20.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return {
        "joints_world_mm": (corners[np.arange(21) % 4] + (x_mm, 0, 1000.0)).ravel(),
        "valid": [True] * 21,
        "reason": [""] * 21,
        "num_views": [2] * 21,
        "reprojection_px": [1.0] * 21,
        "source": "mvexonet" if number else "2d_triangulation",
        "round": number,
    }


def _round(number: int) -> dict[str, Any]:
    return {
        "round": number,
        "box_source": "joints",
        "num_views": 1,
        "is_crop_outside": False,
        "confidence": 1.0,
        "displacement_mm": 1.0,
        "kept_round": number,
        "reason": "",
        "note": "",
    }


def _box() -> dict[str, Any]:
    return {
        "camera_id": CAMERA.camera_id,
        "hand_center_world_mm": [0.0, 0.0, 1000.0],
        "center_rectified_px": [319.5, 239.5],
        "side_px": BOX_SIDE_PX,
        "source": "detected",
        "valid": True,
        "reason": "",
    }


def _crop() -> dict[str, Any]:
    image = encode_jpeg(np.full((120, 120, 3), 90, np.uint8), 95)
    own = crop_camera(CAMERA, (319.5, 239.5), 2 * BOX_SIDE_PX, 120)
    return {"camera_id": CAMERA.camera_id, **camera_to_row(own), "image": image, "valid": True, "reason": ""}


def _rectified() -> dict[str, Any]:
    return {
        "camera_id": CAMERA.camera_id,
        **camera_to_row(CAMERA),
        "kept_fraction": 1.0,
        "valid_region_px": [-0.5, -0.5, 639.5, 479.5],
        "round_trip_residual_px": 0.0,
        "grid_residual_px": 0.0,
        "grid_step_px": 16,
        "grid": RemapGrid.build(CAMERA, CAMERA).to_bytes(),
        "rectified_file": "",
        "rectified_sha256": "",
        "valid": True,
        "reason": "",
    }
