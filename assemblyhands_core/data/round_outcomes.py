"""What a round of annotation gives, as the tables `catalog.JOINTS` and `catalog.ROUNDS`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int, Shaped

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS, ROUNDS
from assemblyhands_core.data.rounds import HandWindows, joints_or_nan
from assemblyhands_core.hands.joints import NUM_JOINTS

CONVERGED: Final = "converged"
TOO_FEW_VIEWS: Final = "too_few_views"
NO_ROOT: Final = "no_root"
LOW_CONFIDENCE: Final = "low_confidence"
KEPT: Final = "kept_round_"
"""How the source of joints begins that are an earlier round's; its number follows."""
_SOURCE: Final = "mvexonet"


@dataclass(frozen=True, eq=False)
class RoundOutcome:
    """What became of each hand in a round.

    Attributes:
        previous: `catalog.JOINTS` of the round before, in the same order.
        windows: Through which each hand was seen.
        joints_world_mm: New estimate; NaN where none was made.
        confidence: Of each joint; NaN where none was made.
        reprojection_px: Of each joint, mean over the views with a keypoint; NaN where there is none.
        reason: Why a hand does not get the new estimate; empty if it does, joint by joint.
        note: The same with figures.
        min_confidence: Joints below are missing.
    """

    previous: pa.Table
    windows: Sequence[HandWindows]
    joints_world_mm: Float[np.ndarray, "hand joint=21 3"]
    confidence: Float[np.ndarray, "hand joint=21"]
    reprojection_px: Float[np.ndarray, "hand joint=21"]
    reason: Shaped[np.ndarray, " hand"]
    note: Shaped[np.ndarray, " hand"]
    min_confidence: float

    @property
    def is_kept(self) -> Bool[np.ndarray, " hand"]:
        """Which hands keep the joints of the round before: those that have any there and no new one."""
        has_any = to_numpy(self.previous["valid"]).astype(bool).any(axis=1)
        return np.asarray(has_any & (self.hand_reason != ""))

    @property
    def hand_reason(self) -> Shaped[np.ndarray, " hand"]:
        """Why hands have no new joint at all; empty if they have."""
        is_unsure = (self.reason == "") & ~(self.confidence >= self.min_confidence).any(axis=1)
        return np.where(is_unsure, LOW_CONFIDENCE, self.reason)

    def joints(self) -> pa.Table:
        """Return the joints of this round, those of the round before where they are kept."""
        previous, kept = self.previous, self.is_kept
        columns = {
            name: np.where(kept[:, None], to_numpy(previous[name]), values) for name, values in self._new().items()
        }
        names = {name: previous[name] for name in ("sequence_id", "frame", "hand")}
        sources = zip(kept, previous["source"].to_pylist(), previous["round"].to_pylist(), strict=True)
        source = [_kept_source(*origin) if is_kept else _SOURCE for is_kept, *origin in sources]
        return JOINTS.build({**names, **columns, "source": source, "round": self._round()})

    def rounds(self) -> pa.Table:
        """Return how each hand came by its joints."""
        moved_mm = displacement_mm(self.joints_world_mm, joints_or_nan(self.previous))
        joints = self.joints()
        return ROUNDS.build(
            {
                **{name: joints[name] for name in ROUNDS.key},
                "box_source": [hand.box_source for hand in self.windows],
                "num_views": [len(hand.views) for hand in self.windows],
                "is_crop_outside": [hand.is_crop_outside for hand in self.windows],
                "confidence": self.confidence.mean(axis=1),
                "displacement_mm": np.where(self.reason == CONVERGED, 0.0, moved_mm),
                "kept_round": [
                    _origin(*pair) for pair in zip(joints["source"].to_pylist(), self._round(), strict=True)
                ],
                "reason": self.hand_reason,
                "note": self.note,
            }
        )

    def _round(self) -> Int[np.ndarray, " hand"]:
        return np.asarray(to_numpy(self.previous["round"]) + 1)

    def _new(self) -> Mapping[str, Shaped[np.ndarray, "hand _value"]]:
        """Return the columns of the new estimate."""
        is_sure = self.confidence >= self.min_confidence
        by_joint = np.where(is_sure, "", LOW_CONFIDENCE).astype(object)
        reasons = np.where((self.reason == "")[:, None], by_joint, self.reason[:, None])
        is_valid = np.asarray(reasons == "")
        points = np.where(is_valid[..., None], self.joints_world_mm, np.nan)
        return {
            "joints_world_mm": points.reshape(len(points), -1),
            "valid": is_valid,
            "reason": reasons,
            "num_views": np.repeat([[len(hand.views)] for hand in self.windows], NUM_JOINTS, axis=1),
            "reprojection_px": np.where(is_valid, self.reprojection_px, np.nan),
        }


def displacement_mm(
    joints_mm: Float[np.ndarray, "hand joint=21 3"], others_mm: Float[np.ndarray, "hand joint=21 3"]
) -> Float[np.ndarray, " hand"]:
    """Return the mean distance of the joints that both know, NaN where there is none."""
    return mean_of_known(np.linalg.norm(joints_mm - others_mm, axis=-1), axis=1)


def mean_of_known(values: Float[np.ndarray, "..."], axis: int) -> Float[np.ndarray, "..."]:
    """Return the mean along an axis of what is finite, NaN where nothing is."""
    is_known = np.isfinite(values)
    count = is_known.sum(axis=axis)
    total = np.where(is_known, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _kept_source(source: str, number: int) -> str:
    """Return how joints that are kept are called: by the round that found them."""
    return source if source.startswith(KEPT) else f"{KEPT}{number}"


def _origin(source: str, number: Any) -> int:
    """Return the round that found joints of this source in this round."""
    return int(source.removeprefix(KEPT)) if source.startswith(KEPT) else int(number)
