"""The submission of the HANDS2023 challenge: its template, filled with joints in the world (formats 4.2)."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from assemblyhands_core.data.assemblyhands import frame_key
from assemblyhands_core.data.json_files import json_object, member, read_json_object, write_json
from assemblyhands_core.hands.joints import NUM_BOTH

SUBMISSION_NAME: Final = "assemblyhands_test_joint_3d_iccv23_pred.json"

BothHands = Float[np.ndarray, "joint=42 3"]


def write_submission(
    template: Path, predicted: Mapping[str, Mapping[int, BothHands]], folder: Path
) -> tuple[Path, list[str]]:
    """Fill the template and zip it.

    Args:
        template: `assemblyhands_test_joint_3d_iccv23-v1-3_pred_template.json`.
        predicted: Recording → 60 Hz key → joints in the world in mm, right hand first; NaN where there is no hand.
        folder: Where the two files go.

    Returns:
        The zipped file, and a sentence for each recording of which frames are not predicted.

    Raises:
        FormatError: The template is not as it should be.
    """
    document = read_json_object(template)
    recordings = json_object(member(document, "annotations", str(template)), f"{template}: annotations")
    problems = []
    for name, value in recordings.items():
        frames = json_object(value, f"{template}: {name}")
        found = {frame_key(key): joints for key, joints in predicted.get(name, {}).items()}
        lost = [key for key in frames if key not in found]
        if lost:
            problems.append(f"{name}: {len(lost)} of {len(frames)} frames are not predicted, {lost[0]} the first")
        for key, block in frames.items():
            json_object(block, f"{template}: {name}, frame {key}")["world_coord"] = _coordinates(found.get(key))
    path = folder / SUBMISSION_NAME
    write_json(path, document)
    with zipfile.ZipFile(path.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path, path.name)
    return path.with_suffix(".zip"), problems


def _coordinates(joints: BothHands | None) -> list[Any]:
    """Return 42 x 3 numbers; a hand that is not there is zeros, as the challenge asks."""
    points: list[Any] = np.nan_to_num(np.zeros((NUM_BOTH, 3)) if joints is None else joints).tolist()
    return points
