"""Which estimates of a round are believed: each beside the round before, a hand's course beside 2D + triangulation."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from assemblyhands_core.data.rounds import KnownHand
from assemblyhands_core.hands.divergence import Course, Divergence, Limits, Step, divergence, unsteadiness
from assemblyhands_core.hands.joints import HANDS, WRIST


@dataclass(frozen=True, eq=False)
class Estimates:
    """New joints of hands and what they are judged by, all in the same order; NaN where unknown.

    Attributes:
        known: What the round before knew of each hand.
        joints_world_mm: The new joints.
        triangulated_world_mm: Those of 2D + triangulation.
        distances_px: From the new joints to the 2D keypoints.
        previous_px: From the joints of the round before to them.
        triangulated_px: From those of 2D + triangulation to them.
        previous_view_share: Share of the views on which the joints of the round before stand, in the mean.
    """

    known: Sequence[KnownHand]
    joints_world_mm: Float[np.ndarray, "hand joint=21 3"]
    triangulated_world_mm: Float[np.ndarray, "hand joint=21 3"]
    distances_px: Float[np.ndarray, "hand view joint=21"]
    previous_px: Float[np.ndarray, "hand view joint=21"]
    triangulated_px: Float[np.ndarray, "hand view joint=21"]
    previous_view_share: Float[np.ndarray, " hand"]


def doubts(
    estimates: Estimates, is_judged: Bool[np.ndarray, " hand"], limits: Limits
) -> tuple[Shaped[np.ndarray, " hand"], Shaped[np.ndarray, " hand"]]:
    """Return why hands are not believed, empty where they are or are not judged, and the same with figures."""
    reason, note = (np.full(len(is_judged), "", dtype=object) for _ in range(2))
    keys = {hand.key: hand for hand in estimates.known}
    for row in np.flatnonzero(is_judged).tolist():
        other = keys.get(estimates.known[row].other_key)
        reason[row], note[row] = divergence(_step(estimates, row, other), limits) or ("", "")
    for rows in _courses(estimates.known, is_judged & (reason == "")):
        reason[rows], note[rows] = _doubt_of_course(estimates, rows, limits) or ("", "")
    return reason, note


def _step(estimates: Estimates, row: int, other: KnownHand | None) -> Step:
    hand = estimates.known[row]
    now_px, before_px = _common_medians(estimates.distances_px[row], estimates.previous_px[row])
    return Step(
        joints_world_mm=estimates.joints_world_mm[row],
        root_world_mm=hand.root_world_mm,
        wrist_world_mm=hand.joints_world_mm[WRIST],
        other_root_world_mm=np.full(3, np.nan) if other is None else other.root_world_mm,
        body_center_world_mm=hand.center_world_mm,
        reprojection_px=now_px,
        previous_reprojection_px=before_px,
        previous_view_share=float(estimates.previous_view_share[row]),
    )


def _courses(known: Sequence[KnownHand], is_believed: Bool[np.ndarray, " hand"]) -> Iterator[Int[np.ndarray, " row"]]:
    """Yield for each hand the rows of its instants that are believed one by one."""
    sides = np.array([hand.key[2] for hand in known])
    for side in HANDS:
        if len(rows := np.flatnonzero(is_believed & (sides == side))):
            yield rows


def _doubt_of_course(estimates: Estimates, rows: Int[np.ndarray, " row"], limits: Limits) -> Divergence | None:
    pixels = _common_medians(estimates.distances_px[rows], estimates.triangulated_px[rows])
    joints = estimates.joints_world_mm[rows], estimates.triangulated_world_mm[rows]
    return unsteadiness(Course(*joints, *pixels), limits)


def _common_medians(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> tuple[float, float]:
    """Return the medians of what both know, NaN where that is nothing."""
    is_common = np.isfinite(one) & np.isfinite(other)
    if not is_common.any():
        return float("nan"), float("nan")
    return float(np.median(one[is_common])), float(np.median(other[is_common]))
