"""What methods say of both hands at the same frames, one layer each, to be shown over one another."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Float64, Integer

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.ground_truth import TRUE_JOINTS, read_ground_truth
from assemblyhands_core.data.keypoint_rows import positions
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.viz.overlays import Color

TRUTH: Final = "truth"
_TRUTH_COLOR: Final[Color] = (150, 150, 150)  # seen on black and on white
# Of Okabe and Ito, as the figures have them: 2D + triangulation, then the rounds.
_COLORS: Final[tuple[Color, ...]] = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (204, 121, 167))

Frames = Integer[np.ndarray, " frame"]


@dataclass(frozen=True, eq=False)
class JointLayer:
    """What one method says.

    Attributes:
        name: Of the method, as an entity and in legends.
        joints_world_mm: Right hand first; NaN where it has none.
        reprojection_px: How far off they are in the views, NaN where unknown.
        color: That stands for it.
    """

    name: str
    joints_world_mm: Float64[np.ndarray, "frame hand=2 joint=21 3"]
    reprojection_px: Float64[np.ndarray, "frame hand=2 joint=21"]
    color: Color

    def mean_error_mm(self, truth: "JointLayer") -> Float64[np.ndarray, "frame hand=2"]:
        """Return the mean distance of the joints that both have; NaN where there are none."""
        return _mean_of_known(np.linalg.norm(self.joints_world_mm - truth.joints_world_mm, axis=-1))

    def mean_reprojection_px(self) -> Float64[np.ndarray, "frame hand=2"]:
        """Return the mean over the joints of each hand; NaN where there are none."""
        return _mean_of_known(self.reprojection_px)


def layer_color(number: int) -> Color:
    """Return the colour of the layer of this number, those of the rounds first."""
    return _COLORS[number % len(_COLORS)]


def joint_layer(name: str, joints: pa.Table, frames: Frames, color: Color) -> JointLayer:
    """Return what a `catalog.JOINTS` table says at these frames.

    Args:
        name: Of the layer.
        joints: Each frame and hand once at most; others than the frames are left out.
        frames: Ascending.
        color: Of the layer.
    """
    reprojection_px = to_numpy(joints["reprojection_px"]).reshape(-1, NUM_JOINTS)
    return JointLayer(
        name,
        _by_frame(joints, joints_or_nan(joints), frames),
        _by_frame(joints, reprojection_px, frames),
        color,
    )


def true_layer(folder: Path, frames: Frames) -> JointLayer:
    """Return what is true at these frames, by a synthetic recording's ground truth."""
    table = read_ground_truth(folder, TRUE_JOINTS)
    joints = to_numpy(table["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3)
    unknown = np.full((len(frames), len(HANDS), NUM_JOINTS), np.nan)
    return JointLayer(TRUTH, _by_frame(table, joints, frames), unknown, _TRUTH_COLOR)


def _by_frame(
    table: pa.Table, values: Float[np.ndarray, " rows *shape"], frames: Frames
) -> Float64[np.ndarray, "frames hands *shape"]:
    """Spread rows over frames and hands; NaN where there is none."""
    spread = np.full((len(frames), len(HANDS), *values.shape[1:]), np.nan)
    frame, hand = to_numpy(table["frame"]), positions(table["hand"], HANDS)
    place = np.minimum(np.searchsorted(frames, frame), max(len(frames) - 1, 0))
    is_wanted = np.asarray(frames[place] == frame) if len(frames) else np.zeros(len(frame), dtype=bool)
    spread[place[is_wanted], hand[is_wanted]] = values[is_wanted]
    return spread


def _mean_of_known(values: Float64[np.ndarray, "frame hand joint"]) -> Float64[np.ndarray, "frame hand"]:
    is_known = np.isfinite(values)
    counts = is_known.sum(axis=-1)
    sums = np.where(is_known, values, 0.0).sum(axis=-1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
