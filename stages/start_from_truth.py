"""Give the true joints as if a round had found them, so that a round can show what perfect crops and roots would give.

It serves evaluation alone: the upper bound of refinement (paper, Sec. 3.1), which nothing that annotates may read.
"""

import numpy as np
import pyarrow.compute as pc

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, SOURCES
from assemblyhands_core.data.rounds import TRUE_ROUND
from assemblyhands_core.hands.joints import NUM_JOINTS
from stages._contract import Context, Stage, StageConfig, Tables
from stages._truth import read_truth


def run(config: StageConfig, inputs: Tables, context: Context) -> Tables:
    """Give the true joints of one chunk of frames."""
    (chunk,) = inputs["chunks"].to_pylist()
    first, end = chunk["first_frame"], chunk["first_frame"] + chunk["num_frames"]
    joints, _ = read_truth(inputs["truth"], context.sequence_id)
    joints = joints.filter((pc.field("frame") >= first) & (pc.field("frame") < end))
    points = to_numpy(joints["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3)
    is_known = np.asarray(np.isfinite(points).all(axis=-1))
    columns = {
        "valid": is_known,
        "reason": np.where(is_known, "", "no_truth").astype(object),
        "num_views": np.zeros(is_known.shape),
        "reprojection_px": np.full(is_known.shape, np.nan),
        "source": ["truth"] * len(points),
        "round": [TRUE_ROUND] * len(points),
    }
    names = ("sequence_id", "frame", "hand", "joints_world_mm")
    return {"joints": JOINTS.build({**{name: joints[name] for name in names}, **columns})}


STAGE = Stage(
    name="start_from_truth",
    version=1,
    config=StageConfig,
    inputs={"truth": SOURCES, "chunks": CHUNKS},
    outputs={"joints": JOINTS},
    run=run,
    shard="chunk",
)
