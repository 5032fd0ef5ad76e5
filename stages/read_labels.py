"""Read who annotated what: the joints of an AssemblyHands `joint_3d` file, by frames of the recording's videos.

Keys count at 60 Hz (formats 2.3). Key 0 is the videos' first frame, or the file's first key is: so it is with the
release's rectified videos.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, JointAnnotations, read_joint_annotations
from assemblyhands_core.data.catalog import HAND_LABELS, JOINTS, SOURCES, VIEWS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from stages._contract import Context, Stage, StageConfig, Tables

_RATE_TOLERANCE = 0.01


class ReadLabelsConfig(StageConfig):
    """Parameters of reading."""

    first_key: int | None = Field(ge=0)


def run(config: ReadLabelsConfig, inputs: Tables, context: Context) -> Tables:
    """Read the labels of one sequence; a row for each hand at each frame with any joint of it.

    Raises:
        ValueError: The file lacks the sequence, or its keys are no frames of the videos.
    """
    (source,) = inputs["sources"].to_pylist()
    recordings = read_joint_annotations(Path(source["source_file"]))
    if context.sequence_id not in recordings:
        raise ValueError(f"{source['source_file']} has no recording {context.sequence_id}: give the file of its split")
    joints = recordings[context.sequence_id]
    frames = _frames(joints, config.first_key, _keys_per_frame(inputs["views"]), source["source_file"])
    rows = [{"sequence_id": context.sequence_id, **row} for row in _rows(joints, frames)]
    return {"labels": HAND_LABELS.from_rows(rows), "joints": JOINTS.from_rows([_as_joints(row) for row in rows])}


def _keys_per_frame(views: pa.Table) -> int:
    rate_hz = float(views.filter(pc.field("valid"))["rate_hz"][0].as_py())
    step = max(1, round(KEY_RATE_HZ / rate_hz))
    if abs(step * rate_hz - KEY_RATE_HZ) > _RATE_TOLERANCE * KEY_RATE_HZ:
        raise ValueError(f"videos of {rate_hz:.2f} Hz: {KEY_RATE_HZ} Hz, at which labels count, is no multiple of it")
    return step


def _frames(joints: JointAnnotations, first_key: int | None, step: int, name: str) -> list[int]:
    first = next((int(key) for key in joints.frames_60hz), 0) if first_key is None else first_key
    odd = [int(key) for key in joints.frames_60hz if key < first or (key - first) % step]
    if odd:
        raise ValueError(
            f"{name}: key {odd[0]} is no frame of videos that begin with key {first} and show every {step}. one, like "
            f"{len(odd)} keys in all; set read_labels.first_key"
        )
    return [(int(key) - first) // step for key in joints.frames_60hz]


def _rows(joints: JointAnnotations, frames: list[int]) -> Iterator[dict[str, Any]]:
    for frame, world, is_valid in zip(frames, joints.joints_world_mm, joints.is_valid, strict=True):
        for hand, points, is_known in zip(HANDS, world, is_valid, strict=True):
            if is_known.any():
                yield {
                    "frame": frame,
                    "hand": hand,
                    "joints_world_mm": points.ravel(),
                    "valid": is_known,
                    "source": "manual",
                    "verb": "",
                    "occlusion_rate": np.nan,
                }


def _as_joints(row: dict[str, Any]) -> dict[str, Any]:
    """Return a label as the stages take joints that were found."""
    return {
        **{name: row[name] for name in ("sequence_id", "frame", "hand", "joints_world_mm", "valid", "source")},
        "reason": np.where(row["valid"], "", "not_annotated").tolist(),
        "num_views": np.zeros(NUM_JOINTS),
        "reprojection_px": np.full(NUM_JOINTS, np.nan),
        "round": 0,
    }


STAGE = Stage(
    name="read_labels",
    version=1,
    config=ReadLabelsConfig,
    inputs={"sources": SOURCES, "views": VIEWS},
    outputs={"labels": HAND_LABELS, "joints": JOINTS},
    run=run,
    shard="sequence",
)
