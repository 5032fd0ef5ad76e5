"""Deliver a synthetic recording as the real data sets would: whole videos, calibration, labels, and the truth apart."""

import shutil
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.assemblyhands import (
    KEY_RATE_HZ,
    RECTIFIED_FOCAL_SCALE,
    EgoCalibration,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.fine_grained import Action, Segment, write_fine_grained_30fps
from assemblyhands_core.data.ground_truth import TRUE_INSTANTS, TRUE_JOINTS, TRUE_VIEWS, write_ground_truth
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.names import parse_recording_name
from assemblyhands_core.data.split_files import ACTIONS_SHARE, EGO_SHARE, JOINTS_SHARE
from assemblyhands_core.data.studio_tables import (
    ACTIONS,
    DELIVERED,
    FOOTAGE,
    TAKES,
)
from assemblyhands_core.data.video_concatenation import concatenate
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.annotator import annotate
from assemblyhands_core.synthetic.rig import Rig
from assemblyhands_core.synthetic.session import Order
from assemblyhands_core.synthetic.toys import NOUNS, toy_name
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals

_DRAFT = "dataset"
_SEGMENT_RATE_HZ: Final = 30  # of Assembly101's file, whatever the videos' rate


class DeliverRecordingConfig(StageConfig):
    """Parameters of delivery."""

    labelled_every_s: float = Field(gt=0, allow_inf_nan=False)


def run(config: DeliverRecordingConfig, inputs: Tables, context: Context) -> Tables:
    """Write the files of one recording."""
    order = Order.of(inputs["takes"])
    rig, layout = order.build_rig(), DatasetLayout(context.blob_dir / _DRAFT)
    _write_videos(inputs["footage"], order, layout)
    write_assembly101_calibration(layout.calibration(order.recording), [*rig.exo.values(), *rig.ego.values()])
    write_ground_truth(
        layout.ground_truth(order.recording),
        {spec.name: inputs[spec.name] for spec in (TRUE_JOINTS, TRUE_VIEWS, TRUE_INSTANTS)},
    )
    _write_labels(config, inputs, order, rig, layout.labels(order.recording))
    return {"delivered": DELIVERED.from_rows(_flattened(layout.root, context))}


def _write_videos(footage: pa.Table, order: Order, layout: DatasetLayout) -> None:
    parts: dict[str, list[dict[str, Any]]] = {}
    for row in footage.to_pylist():
        parts.setdefault(row["camera_id"], []).append(row)
    for camera_id, rows in parts.items():
        path = layout.video(order.recording, camera_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        concatenate([Path(row["video_file"]) for row in sorted(rows, key=lambda row: int(row["first_frame"]))], path)


def _write_labels(config: DeliverRecordingConfig, inputs: Tables, order: Order, rig: Rig, folder: Path) -> None:
    """Write this recording's share of the files of its split."""
    step = max(1, round(config.labelled_every_s * order.rate_hz))
    frames = range(0, order.num_frames, step)
    labels = annotate(order.recording, inputs["true_joints"], inputs["true_views"], frames, order.rate_hz)
    write_joint_annotations(folder / JOINTS_SHARE, {order.recording: labels})
    if rig.ego:
        ego = _ego_calibration(rig, inputs["true_instants"], order.rate_hz)
        write_ego_calibration(folder / EGO_SHARE, {order.recording: ego})
    views = sorted({row["camera_id"] for row in inputs["footage"].to_pylist()})
    write_fine_grained_30fps(folder / ACTIONS_SHARE, _segments(inputs["actions"], order, tuple(views)))


def _ego_calibration(rig: Rig, instants: pa.Table, rate_hz: int) -> EgoCalibration:
    poses = to_numpy(instants["T_headset_from_world"]).reshape(-1, 4, 4)
    cameras = [rig.ego_at(pose) for pose in poses]
    return EgoCalibration(
        camera_ids=tuple(rig.ego),
        K_px=np.stack([_rectified_K(camera) for camera in rig.ego.values()]),
        frames_60hz=to_numpy(instants["frame"]) * (KEY_RATE_HZ // rate_hz),
        T_camera_from_world=np.stack([[there[name].T_camera_from_world for name in rig.ego] for there in cameras]),
    )


def _rectified_K(camera: Camera) -> Any:
    return camera.K * np.array([[RECTIFIED_FOCAL_SCALE, 1, 1], [1, RECTIFIED_FOCAL_SCALE, 1], [1, 1, 1]])


def _segments(actions: pa.Table, order: Order, views: tuple[str, ...]) -> list[Segment]:
    """Return each action once, also where both hands do the same."""
    toy = parse_recording_name(order.recording).toy
    found = [
        Segment(
            recording=order.recording,
            start_frame=round(row["start_s"] * _SEGMENT_RATE_HZ),
            end_frame=max(round(row["start_s"] * _SEGMENT_RATE_HZ), round(row["end_s"] * _SEGMENT_RATE_HZ) - 1),
            rate_hz=_SEGMENT_RATE_HZ,
            action=Action.of(row["verb"], row["noun"], NOUNS),
            toy_id=toy,
            toy_name=toy_name(toy, order.things),
            views=views,
        )
        for row in actions.to_pylist()
    ]
    return list(dict.fromkeys(found))


def _flattened(root: Path, context: Context) -> list[dict[str, str]]:
    """Move all files below a folder into the entry, which has no folders; return a row for each."""
    rows = []
    for file in sorted(path for path in root.rglob("*") if path.is_file()):
        path = file.relative_to(root).as_posix()
        name = blob_name(path, file.suffix)
        file.rename(context.blob_dir / name)
        digest = digest_file(context.blob_dir / name)
        rows.append({"sequence_id": context.sequence_id, "path": path, "content_file": name, "sha256": digest})
    shutil.rmtree(root)
    return rows


STAGE = Stage(
    name="deliver_recording",
    version=3,
    config=DeliverRecordingConfig,
    inputs={
        "takes": TAKES,
        "actions": ACTIONS,
        "footage": FOOTAGE,
        "true_joints": TRUE_JOINTS,
        "true_views": TRUE_VIEWS,
        "true_instants": TRUE_INSTANTS,
    },
    outputs={"delivered": DELIVERED},
    run=run,
    shard="sequence",
    externals=simulator_externals,
)
