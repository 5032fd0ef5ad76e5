"""Joints of an AssemblyHands `joint_3d` file as rows by frames of pictures.

Keys count at 60 Hz (formats 2.3). Pictures of raw videos begin with key 0, those of the release with the file's first.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, JointAnnotations, read_joint_annotations
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS

FROM_FIRST_KEY: Final = "joint_3d_release"
"""What a source is called whose first key is the pictures' first frame; otherwise key 0 is."""

MANUAL: Final = "manual"
_RATE_TOLERANCE: Final = 0.01


def keys_per_frame(rate_hz: float) -> int:
    """Return how far apart the keys of two pictures in a row are.

    Raises:
        ValueError: Pictures do not come at a whole part of the keys' rate.
    """
    step = max(1, round(KEY_RATE_HZ / rate_hz))
    if abs(step * rate_hz - KEY_RATE_HZ) > _RATE_TOLERANCE * KEY_RATE_HZ:
        raise ValueError(f"videos of {rate_hz:.2f} Hz: {KEY_RATE_HZ} Hz, at which labels count, is no multiple of it")
    return step


def read_recording(source: Mapping[str, Any], sequence_id: str) -> JointAnnotations:
    """Read one recording's joints out of its split's file.

    Args:
        source: Row of `catalog.SOURCES`.
        sequence_id: The recording.

    Raises:
        ValueError: The file lacks it.
        FormatError: The file is not as it should be.
    """
    recordings = read_joint_annotations(Path(source["source_file"]), sequence_id)
    if sequence_id not in recordings:
        raise ValueError(f"{source['source_file']} has no recording {sequence_id}: give the file of its split")
    return recordings[sequence_id]


def first_key_of(source: Mapping[str, Any], joints: JointAnnotations) -> int:
    """Return the key of the pictures' first frame."""
    return next((int(key) for key in joints.frames_60hz), 0) if source["name"] == FROM_FIRST_KEY else 0


def label_rows(
    sequence_id: str, joints: JointAnnotations, first_key: int, step: int, name: str
) -> list[dict[str, Any]]:
    """Return a row of `training_tables.HAND_LABELS` for each hand of which any joint is annotated.

    Args:
        sequence_id: The recording.
        joints: Its joints.
        first_key: Key of frame 0.
        step: Keys between frames, see `keys_per_frame`.
        name: Of the file, for the message.

    Raises:
        ValueError: A key is no frame.
    """
    odd = [int(key) for key in joints.frames_60hz if key < first_key or (key - first_key) % step]
    if odd:
        raise ValueError(
            f"{name}: key {odd[0]} is no frame of videos that begin with key {first_key} and show every {step}. one, "
            f"like {len(odd)} keys in all; set read_labels.first_key and ingest_ego.first_key"
        )
    frames = [(int(key) - first_key) // step for key in joints.frames_60hz]
    return [{"sequence_id": sequence_id, **row} for row in _rows(joints, frames)]


def as_joint_rows(labels: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return labels as the stages take joints that were found: rows of `catalog.JOINTS`."""
    names = ("sequence_id", "frame", "hand", "joints_world_mm", "valid", "source")
    return [
        {
            **{name: row[name] for name in names},
            "reason": np.where(row["valid"], "", "not_annotated").tolist(),
            "num_views": np.zeros(NUM_JOINTS),
            "reprojection_px": np.full(NUM_JOINTS, np.nan),
            "round": 0,
        }
        for row in labels
    ]


def _rows(joints: JointAnnotations, frames: list[int]) -> Iterator[dict[str, Any]]:
    for frame, world, is_valid in zip(frames, joints.joints_world_mm, joints.is_valid, strict=True):
        for hand, points, is_known in zip(HANDS, world, is_valid, strict=True):
            if is_known.any():
                yield {
                    "frame": frame,
                    "hand": hand,
                    "joints_world_mm": points.ravel(),
                    "valid": is_known,
                    "source": MANUAL,
                    "verb": "",
                    "occlusion_rate": np.nan,
                }
