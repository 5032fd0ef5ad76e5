"""Clean up the joints of a whole sequence over time: an optional last stage, beside which the raw joints stay.

Samples far off a joint's course are damped, short gaps are filled, and the bones of a hand get constant lengths. The
paper's tables are made without it.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.keypoint_rows import positions
from assemblyhands_core.data.rounds import SMOOTHED, joints_or_nan
from assemblyhands_core.geometry.smoothing import SmoothingRule, smooth
from assemblyhands_core.hands.constant_bones import with_constant_bones
from assemblyhands_core.hands.joints import HANDS
from stages._contract import Context, Stage, StageConfig, Tables

Floats = npt.NDArray[np.floating[Any]]
Flags = npt.NDArray[np.bool_]


class SmoothJointsConfig(StageConfig):
    """Parameters of the smoothing, see `SmoothingRule`."""

    max_gap_frames: int = Field(ge=0)
    cutoff_period_frames: float = Field(gt=2)
    max_deviation_sd: float = Field(gt=2)


def run(config: SmoothJointsConfig, inputs: Tables, context: Context) -> Tables:
    """Smooth one sequence; one row for each row of the joints, those of smoothed joints tell of the raw ones' views."""
    joints = inputs["joints"]
    if not joints.num_rows:
        return {"joints": JOINTS.empty()}
    points, is_filled = _smoothed(joints, SmoothingRule(**config.model_dump()))
    return {
        "joints": JOINTS.build(
            {
                **{name: joints[name] for name in JOINTS.key},
                "joints_world_mm": points.reshape(len(points), -1),
                "valid": np.isfinite(points).all(axis=-1),
                "reason": np.where(is_filled, "", to_numpy(joints["reason"])),
                "num_views": np.where(is_filled, 0, to_numpy(joints["num_views"])),
                "reprojection_px": np.where(is_filled, np.nan, to_numpy(joints["reprojection_px"])),
                "source": [SMOOTHED] * len(points),
            }
        )
    }


def _smoothed(joints: pa.Table, rule: SmoothingRule) -> tuple[Floats, Flags]:
    """Return the smoothed joints (R, 21, 3) of each row, NaN where missing, and which fill a gap (R, 21)."""
    points, frame, side = joints_or_nan(joints), to_numpy(joints["frame"]), positions(joints["hand"], HANDS)
    is_filled = np.zeros(points.shape[:2], dtype=bool)
    for hand in range(len(HANDS)):
        rows = np.flatnonzero(side == hand)
        rows = rows[np.argsort(frame[rows])]
        course, is_filled[rows] = smooth(points[rows], frame[rows], rule)
        points[rows] = with_constant_bones(course)
    return points, is_filled


STAGE = Stage(
    name="smooth_joints",
    version=1,
    config=SmoothJointsConfig,
    inputs={"joints": JOINTS},
    outputs={"joints": JOINTS},
    run=run,
    shard="sequence",
)
