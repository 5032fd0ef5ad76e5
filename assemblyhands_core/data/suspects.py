"""Which annotated hands a person should look at first, and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.keypoint_rows import rows_of_hands
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.round_outcomes import CONVERGED, mean_of_known
from assemblyhands_core.hands.joints import NUM_JOINTS

_WORST: Final = 10.0  # times its limit: farther off is as bad
_KEPT_SEVERITY: Final = 2.0  # of a round that was not believed, beside figures at twice their limit

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True)
class SuspicionLimits:
    """What makes a hand suspicious.

    Attributes:
        min_confidence: Of the network in the last round, mean over the joints.
        max_distance_px: Of the last round's joints, in the mean.
        max_displacement_mm: From one round to the next, mean over the joints.
        min_joints: Fewer known ones are suspicious.
    """

    min_confidence: float
    max_distance_px: float
    max_displacement_mm: float
    min_joints: int


@dataclass(frozen=True)
class Suspect:
    """A hand at an instant that is probably wrong.

    Attributes:
        severity: Sum over what is suspicious of how many times its limit it is.
        reasons: In words, with figures.
    """

    frame: int
    hand: str
    severity: float
    reasons: tuple[str, ...]


def find_suspects(
    joints: pa.Table, rounds: Sequence[pa.Table], residuals: pa.Table, limits: SuspicionLimits
) -> list[Suspect]:
    """Return the suspicious hands, by frame; not those that people have corrected.

    Args:
        joints: `catalog.JOINTS` of the last round.
        rounds: `catalog.ROUNDS` of each round from the first on; none where there is only round 0.
        residuals: `catalog.RESIDUALS` of round 0: its joints know of the views alone that agree with them.
        limits: What is suspicious.
    """
    found: list[list[tuple[float, str]]] = [[] for _ in range(joints.num_rows)]
    _note_missing(found, joints, limits.min_joints)
    error_px = _error_px(joints) if rounds else _residual_px(joints, residuals)
    _note(found, error_px / limits.max_distance_px, "off its 2D keypoints by {:.1f} px", error_px)
    for number, table in enumerate(rounds, start=1):
        place = rows_of_hands(joints, table)
        moved_mm = to_numpy(table["displacement_mm"])[place].astype(np.float64)
        _note(found, moved_mm / limits.max_displacement_mm, f"moved {{:.0f}} mm in round {number}", moved_mm)
    if rounds:
        _note_last(found, rounds[-1].take(rows_of_hands(joints, rounds[-1])), limits.min_confidence)
    names = (joints[name].to_pylist() for name in ("frame", "hand", "source"))
    return [
        Suspect(frame, hand, sum(severity for severity, _ in why), tuple(text for _, text in why))
        for why, frame, hand, source in zip(found, *names, strict=True)
        if why and source != MANUAL
    ]


def choose_suspects(suspects: Sequence[Suspect], max_instants: int, min_gap_frames: int) -> list[Suspect]:
    """Return the worst, worst first; of one hand none that are nearer in time: neighbours go wrong together."""
    chosen: list[Suspect] = []
    for suspect in sorted(suspects, key=lambda s: (-s.severity, s.frame, s.hand)):
        near = (c for c in chosen if c.hand == suspect.hand and abs(c.frame - suspect.frame) < min_gap_frames)
        if len(chosen) < max_instants and not any(near):
            chosen.append(suspect)
    return chosen


def _error_px(joints: pa.Table) -> Floats:
    """Return how far each hand's joints are from 2D keypoints, in the mean over views and joints."""
    return mean_of_known(to_numpy(joints["reprojection_px"]).astype(np.float64), axis=1)


def _residual_px(joints: pa.Table, residuals: pa.Table) -> Floats:
    """Return the same of triangulated hands, with views that do not agree."""
    by_view_px = to_numpy(residuals["residual_px"]).astype(np.float64)
    is_known, place = np.isfinite(by_view_px), rows_of_hands(residuals, joints)
    total_px, count = (
        np.bincount(place, values.sum(axis=1), joints.num_rows)
        for values in (np.where(is_known, by_view_px, 0.0), is_known)
    )
    return np.where(count > 0, total_px / np.maximum(count, 1), np.nan)


def _note_missing(found: list[list[tuple[float, str]]], joints: pa.Table, min_joints: int) -> None:
    num_known = to_numpy(joints["valid"]).astype(bool).sum(axis=1)
    for why, known, reasons in zip(found, num_known.tolist(), joints["reason"].to_pylist(), strict=True):
        if known < min_joints:
            causes = sorted(set(reasons) - {""})
            why.append((1 + (NUM_JOINTS - known) / NUM_JOINTS, f"{NUM_JOINTS - known} missing: {', '.join(causes)}"))


def _note_last(found: list[list[tuple[float, str]]], last: pa.Table, min_confidence: float) -> None:
    confidence = to_numpy(last["confidence"]).astype(np.float64)
    times = min_confidence / np.maximum(confidence, min_confidence / _WORST)
    _note(found, times, "confidence {:.2f}", confidence)
    for why, reason in zip(found, last["reason"].to_pylist(), strict=True):
        if reason not in ("", CONVERGED):
            why.append((_KEPT_SEVERITY, f"last round not believed: {reason}"))


def _note(found: list[list[tuple[float, str]]], times: Floats, text: str, values: Floats) -> None:
    """Note where figures are beyond their limit, so many times; NaN is not."""
    for row in np.flatnonzero(times > 1):
        found[row].append((min(float(times[row]), _WORST), text.format(values[row])))
