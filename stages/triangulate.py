"""Triangulate the 2D keypoints of all views: round 0, the paper's baseline "2D + Triangulation" (Sec. 3.1).

It also gives the later rounds the root of their volume. Each joint is solved on its own, robustly, and says how many
views agree on it, how well, or why there is none (supplement: "either too few 2D detections or large triangulation
error").
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import CORRECTIONS, JOINTS, KEYPOINTS, RESIDUALS, VIEWS
from assemblyhands_core.data.corrections import held_joints, is_corrected, with_corrections
from assemblyhands_core.data.keypoint_rows import hand_codes, keypoints_by_view, positions
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.outcomes import outcome_columns
from assemblyhands_core.data.rounds import TRIANGULATED
from assemblyhands_core.data.strays import without_strays
from assemblyhands_core.geometry.triangulation import Triangulation, triangulate
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from stages._contract import Context, Stage, StageConfig, Tables

_ROUND = 0

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


class TriangulateConfig(StageConfig):
    """Parameters of triangulation."""

    max_reprojection_px: float = Field(gt=0)
    min_confidence: float = Field(ge=0, le=1)
    min_views: int = Field(ge=2)
    min_parallax_rad: float = Field(ge=0, lt=np.pi)
    max_span_mm: float = Field(gt=0)


@dataclass(frozen=True, eq=False)
class _Hands:
    """The rows of a keypoints table by hand and view.

    Attributes:
        frame, hand: (G,) of each hand at each instant, by frame, right before left.
        row_hand, row_view: (R,) place of each row; view -1 where the camera cannot be used.
    """

    frame: Indices
    hand: npt.NDArray[Any]
    row_hand: Indices
    row_view: Indices

    @property
    def names(self) -> pa.Table:
        """Return a row for each hand at each instant."""
        return pa.table({"frame": self.frame, "hand": pa.array(self.hand, pa.string())})


def run(config: TriangulateConfig, inputs: Tables, context: Context) -> Tables:
    """Triangulate all frames, hands and joints of a shard at once; what people corrected counts more than detectors."""
    cameras, corrections = valid_cameras(inputs["views"]), inputs.get("corrections", CORRECTIONS.empty())
    keypoints = with_corrections(inputs["keypoints"], corrections)
    if not keypoints.num_rows:
        return {"joints": JOINTS.empty(), "residuals": RESIDUALS.empty()}
    hands = _group(keypoints, list(cameras))
    place = hands.row_hand, hands.row_view, len(hands.frame), len(cameras)
    by_view = keypoints_by_view(keypoints, *place, config.min_confidence)
    pixels, confidence = (values.swapaxes(1, 2) for values in by_view)
    found = triangulate(
        pixels.reshape(-1, len(cameras), 2),
        list(cameras.values()),
        confidence.reshape(-1, len(cameras)),
        max_reprojection_px=config.max_reprojection_px,
        min_views=config.min_views,
        min_parallax_rad=config.min_parallax_rad,
    )
    found = without_strays(found, config.max_span_mm, held_joints(hands.names, corrections))
    joints = _joints(hands, found, pixels, is_corrected(hands.names, corrections), context)
    return {"joints": joints, "residuals": _residuals(keypoints, hands, found)}


def _group(keypoints: pa.Table, camera_ids: list[str]) -> _Hands:
    """Find out which hand, instant and view each row is about."""
    codes, row_hand = np.unique(hand_codes(keypoints), return_inverse=True)
    row_view = positions(keypoints.column("camera_id"), camera_ids)
    names = np.array(HANDS, dtype=object)
    return _Hands(codes // len(HANDS), names[codes % len(HANDS)], row_hand, row_view)


def _joints(
    hands: _Hands, found: Triangulation, pixels: Floats, is_manual: npt.NDArray[np.bool_], context: Context
) -> pa.Table:
    num_hands = len(hands.frame)
    outcome = outcome_columns(found, NUM_JOINTS)
    is_unseen = ~np.isfinite(pixels).all(axis=-1).any(axis=-1)
    outcome["reason"] = np.where(is_unseen, "no_detection", outcome["reason"])
    return JOINTS.build(
        {
            "sequence_id": [context.sequence_id] * num_hands,
            "frame": hands.frame,
            "hand": hands.hand,
            "joints_world_mm": found.points_world_mm.reshape(num_hands, -1),
            **outcome,
            "source": np.where(is_manual, MANUAL, TRIANGULATED),
            "round": [_ROUND] * num_hands,
        }
    )


def _residuals(keypoints: pa.Table, hands: _Hands, found: Triangulation) -> pa.Table:
    """Return each view's distance to the joint, outliers too, a row for every row of keypoints."""
    by_joint = (len(hands.frame), NUM_JOINTS, -1)
    is_valid = (found.status == "ok")[:, None]
    residual_px = np.where(is_valid, found.reprojection_px, np.nan).reshape(by_joint)
    is_inlier = (is_valid & found.is_inlier).reshape(by_joint)
    place = hands.row_hand, slice(None), hands.row_view
    is_known = (hands.row_view >= 0)[:, None]
    names = {name: keypoints.column(name) for name in RESIDUALS.key}
    return RESIDUALS.build(
        {
            **names,
            "residual_px": np.where(is_known, residual_px[place], np.nan),
            "is_inlier": is_known & is_inlier[place],
        }
    )


STAGE = Stage(
    name="triangulate",
    version=1,
    config=TriangulateConfig,
    inputs={"views": VIEWS, "keypoints": KEYPOINTS, "corrections": CORRECTIONS},
    outputs={"joints": JOINTS, "residuals": RESIDUALS},
    run=run,
    shard="chunk",
    optional=frozenset({"corrections"}),
)
