"""When a new estimate of a hand is not to be believed: it jumped, took the other hand, or is no hand.

Refinement feeds on its own output, so that an error once made would be carried on from round to round.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.joints import ROOT, WRIST
from assemblyhands_core.hands.kinematics import HandSkeleton, bone_lengths_mm
from assemblyhands_core.hands.steadiness import bones_spread_mm


@dataclass(frozen=True)
class Limits:
    """What is still believed.

    Attributes:
        max_displacement_mm: Of root and wrist between two rounds.
        max_body_distance_mm: From the root to where the body says that the hand is.
        min_size, max_size: Sum of all bones over that of a mean adult's hand.
        max_bone_mm: Longest bone.
        max_reprojection_ratio: Reprojection error over that of the round before.
        min_reprojection_px: Errors below are never too large.
        min_view_share: Share of the views that the round before must stand on; less says nothing about the new one.
        max_spread_ratio: Spread of the bones' lengths over time, over that of 2D + triangulation ...
        max_course_px_ratio: ... where the course's reprojection error over that of 2D + triangulation is large, too.
        min_instants: Spread over fewer says nothing.
    """

    max_displacement_mm: float
    max_body_distance_mm: float
    min_size: float
    max_size: float
    max_bone_mm: float
    max_reprojection_ratio: float
    min_reprojection_px: float
    min_view_share: float
    max_spread_ratio: float
    max_course_px_ratio: float
    min_instants: int


@dataclass(frozen=True, eq=False)
class Step:
    """A new estimate and what it came from; NaN where unknown, which is held against nobody.

    Attributes:
        joints_world_mm: The new estimate.
        root_world_mm: Root that it was made around.
        wrist_world_mm: Wrist of the round before.
        other_root_world_mm: The other hand's root in the round before.
        body_center_world_mm: Where the body says that the hand is.
        reprojection_px: Of the new estimate against the 2D keypoints.
        previous_reprojection_px: Of the round before against the same ones.
        previous_view_share: Share of the views on which the joints of the round before stand, in the mean.
    """

    joints_world_mm: Float[np.ndarray, "joint=21 3"]
    root_world_mm: Float[np.ndarray, "3"]
    wrist_world_mm: Float[np.ndarray, "3"]
    other_root_world_mm: Float[np.ndarray, "3"]
    body_center_world_mm: Float[np.ndarray, "3"]
    reprojection_px: float
    previous_reprojection_px: float
    previous_view_share: float


class Divergence(NamedTuple):
    """Why an estimate is not believed: the name of the reason, and a note with the value."""

    reason: str
    note: str


def divergence(step: Step, limits: Limits) -> Divergence | None:
    """Return the first reason not to believe an estimate, none if there is none."""
    return _bones(step, limits) or _jump(step, limits) or _place(step, limits) or _reprojection(step, limits)


@dataclass(frozen=True, eq=False)
class Course:
    """New estimates of one hand over time, beside those of 2D + triangulation.

    Attributes:
        joints_world_mm, triangulated_world_mm: NaN where unknown.
        reprojection_px, triangulated_reprojection_px: Medians over all instants, against the same 2D keypoints.
    """

    joints_world_mm: Float[np.ndarray, "instant joint=21 3"]
    triangulated_world_mm: Float[np.ndarray, "instant joint=21 3"]
    reprojection_px: float
    triangulated_reprojection_px: float


def unsteadiness(course: Course, limits: Limits) -> Divergence | None:
    """Return why 2D + triangulation was the better one all along, none if it was not.

    It was if the hand kept its shape better there and fitted its 2D keypoints better, too. That alone would say little:
    2D + triangulation fits them as closely as can be, errors and all. Joints count at instants where both know them.
    """
    is_common = np.isfinite(course.joints_world_mm + course.triangulated_world_mm).all(axis=-1)
    now_mm, first_mm = (
        bones_spread_mm(np.where(is_common[..., None], points, np.nan))
        for points in (course.joints_world_mm, course.triangulated_world_mm)
    )
    now_px, first_px = course.reprojection_px, course.triangulated_reprojection_px
    is_long = int(is_common.any(axis=1).sum()) >= limits.min_instants
    if is_long and now_mm > limits.max_spread_ratio * first_mm and now_px > limits.max_course_px_ratio * first_px:
        bones = f"bones vary by {now_mm:.1f} mm, {first_mm:.1f} mm in 2D + triangulation"
        return Divergence("unsteady", f"{bones}; {now_px:.1f} px from the 2D keypoints, {first_px:.1f} px there")
    return None


def _bones(step: Step, limits: Limits) -> Divergence | None:
    lengths_mm = bone_lengths_mm(step.joints_world_mm)
    size = float(lengths_mm.sum() / HandSkeleton.average().bone_lengths_mm.sum())
    longest_mm = float(lengths_mm.max())
    if not limits.min_size <= size <= limits.max_size:
        return Divergence("implausible_bones", f"{size:.2f} of a mean hand's size")
    if longest_mm > limits.max_bone_mm:
        return Divergence("implausible_bones", f"a bone of {longest_mm:.0f} mm")
    return None


def _jump(step: Step, limits: Limits) -> Divergence | None:
    root_mm = _distance(step.joints_world_mm[ROOT], step.root_world_mm)
    wrist_mm = _distance(step.joints_world_mm[WRIST], step.wrist_world_mm)
    for name, distance_mm in (("root", root_mm), ("wrist", wrist_mm)):
        if distance_mm > limits.max_displacement_mm:
            return Divergence("jumped", f"its {name} jumped {distance_mm:.0f} mm")
    return None


def _place(step: Step, limits: Limits) -> Divergence | None:
    root = step.joints_world_mm[ROOT]
    own_mm, other_mm = _distance(root, step.root_world_mm), _distance(root, step.other_root_world_mm)
    if other_mm < own_mm:
        return Divergence("other_hand", f"{own_mm:.0f} mm from where it was, {other_mm:.0f} mm from the other hand")
    body_mm = _distance(root, step.body_center_world_mm)
    if body_mm > limits.max_body_distance_mm:
        return Divergence("left_body", f"{body_mm:.0f} mm from the body's hand")
    return None


def _reprojection(step: Step, limits: Limits) -> Divergence | None:
    if step.previous_view_share < limits.min_view_share:
        return None
    now_px, before_px = step.reprojection_px, step.previous_reprojection_px
    if now_px > limits.min_reprojection_px and now_px > limits.max_reprojection_ratio * before_px:
        return Divergence("high_reprojection", f"{now_px:.1f} px from the 2D keypoints, before {before_px:.1f} px")
    return None


def _distance(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(a - b))
