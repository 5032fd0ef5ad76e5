"""The truth of a made-up recording on disk, for the stages that evaluate."""

from pathlib import Path

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.catalog import SOURCES
from assemblyhands_core.data.ground_truth import TRUE_INSTANTS, TRUE_JOINTS, TRUE_VIEWS, write_ground_truth
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS

NUM_FRAMES = 12
TRUE_MM = np.random.default_rng(0).normal(0, 100, (NUM_FRAMES, 2, NUM_JOINTS, 3)).astype(np.float32)


def write_truth(folder: Path, sequence_id: str = "s", frames: int = NUM_FRAMES) -> pa.Table:
    """Write the truth of a recording: two actions, and occlusion that grows."""
    hands = {
        "sequence_id": [sequence_id] * 2 * NUM_FRAMES,
        "frame": np.repeat(np.arange(NUM_FRAMES), 2),
        "hand": list(HANDS) * NUM_FRAMES,
        "joints_world_mm": TRUE_MM.reshape(2 * NUM_FRAMES, -1),
    }
    instants = {
        "sequence_id": [sequence_id] * frames,
        "frame": np.arange(frames),
        "exo_occlusion_rate": np.linspace(0, 1, frames),
        "ego_occlusion_rate": np.zeros(frames),
        "verb": ["screw"] * 6 + [""] * (frames - 6),
        "noun": [""] * frames,
        "T_headset_from_world": np.full((frames, 16), np.nan),
    }
    tables = {"true_joints": TRUE_JOINTS.build(hands), "true_instants": TRUE_INSTANTS.build(instants)}
    write_ground_truth(folder, {**tables, "true_views": TRUE_VIEWS.empty()})
    names = ("true_instants", "true_joints", "true_views")
    return SOURCES.from_rows(
        [
            {"sequence_id": "s", "role": "ground_truth", "name": name, "source_file": str(folder / f"{name}.parquet"),
             "sha256": ""} for name in names
        ]
    )  # fmt: skip
