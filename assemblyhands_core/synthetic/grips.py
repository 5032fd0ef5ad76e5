"""Where a hand takes hold of things: contacts of fingertips solved for, from a named grasp as the start.

Grip frame, mm: the origin lies between the thumb and the fingers, x points from the thumb to the fingers, z the way the
hand came to take hold (so that the hand is on the side of -z), y = z × x. `T_part_from_grip` says where a part may be
gripped, `T_wrist_from_grip` where that is in a hand; the left hand's is the mirror image S T S, S = diag(-1, 1, 1, 1).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.grasps import Grasp, blended_grasps_rad, grasp_angles_rad
from assemblyhands_core.hands.joints import FINGERS, Hand
from assemblyhands_core.hands.kinematics import (
    MIRROR,
    HandPose,
    HandSkeleton,
    clamp_to_limits,
    forward_kinematics,
)
from assemblyhands_core.synthetic.motion import rotation

Contact = Literal["pinch", "tripod", "hold", "round", "wrap"]

PAD_MM: Final = 7.0
"""From the joint in a fingertip to the skin that touches."""
OPENING_MM: Final = 16.0
"""How much further from the object each finger is before it touches."""


@dataclass(frozen=True)
class GripKind:
    """A way to take hold.

    Attributes:
        contact: Which fingertips touch where: two, three or four on flat sides ("pinch", "tripod", "hold"), three or
            four around an axis along z ("round"), all five around an axis along y ("wrap").
        width_mm: Of the object between thumb and fingers.
    """

    contact: Contact
    width_mm: float


@dataclass(frozen=True, eq=False)
class HandGrip:
    """A grip in a hand: where it is and how the fingers are bent before, at and without contact."""

    T_wrist_from_grip: Float64[np.ndarray, "4 4"]
    closed_rad: Float64[np.ndarray, "20"]
    open_rad: Float64[np.ndarray, "20"]


def solve_grip(skeleton: HandSkeleton, kind: GripKind, hand: Hand) -> HandGrip:
    """Find the place of a grip in a hand and the bend of the fingers that bring the fingertips to their contacts.

    Args:
        skeleton: The hand's lengths.
        kind: What is gripped.
        hand: Which hand.

    Returns:
        Joint angles within the limits; the open ones have the same grip frame with the fingers further apart.
    """
    nominal = _NOMINAL[kind.contact]
    spread = np.clip((kind.width_mm - _NARROW_MM) / _WIDE_MM, 0.0, 1.0)
    named = blended_grasps_rad(grasp_angles_rad(nominal.grasp), grasp_angles_rad("open"), spread)
    start = np.concatenate([np.zeros(6), named])
    closed = _solve(skeleton, nominal, _contacts_mm(kind), start, free_frame=True)
    wider = replace(kind, width_mm=kind.width_mm + 2 * OPENING_MM)
    opened = _solve(skeleton, nominal, _contacts_mm(wider), closed, free_frame=False)
    T_wrist_from_grip = _frame(nominal, closed[:6])
    if hand == "left":
        T_wrist_from_grip = MIRROR @ T_wrist_from_grip @ MIRROR
    return HandGrip(T_wrist_from_grip, clamp_to_limits(closed[6:]), clamp_to_limits(opened[6:]))


def _contacts_mm(kind: GripKind) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Where the joints in the touching fingertips have to be, in the grip frame of a right hand."""
    reach = kind.width_mm / 2 + PAD_MM
    if kind.contact == "pinch":
        return {"thumb": np.array([-reach, 0.0, 0.0]), "index": np.array([reach, 0.0, 0.0])}
    if kind.contact == "tripod":
        sides = {"index": np.array([reach, -10.0, 0.0]), "middle": np.array([reach, 10.0, 0.0])}
        return {"thumb": np.array([-reach, 0.0, 0.0]), **sides}
    if kind.contact == "hold":
        sides = {f: np.array([reach, y, 0.0]) for f, y in (("index", -20.0), ("middle", 0.0), ("ring", 19.0))}
        return {"thumb": np.array([-reach, -8.0, 0.0]), **sides}
    if kind.contact == "round":
        least = max(1.0, 10.0 / reach)
        azimuth = {"thumb": np.pi, "index": -0.55 * least, "middle": 0.3 * least, "ring": 0.3 * least + 20.0 / reach}
        touching = list(azimuth)[: 4 if reach > 22.0 else 3]
        return {f: reach * np.array([np.cos(azimuth[f]), np.sin(azimuth[f]), 0.0]) for f in touching}
    around = {"thumb": np.pi - 0.2, "index": 0.2, "middle": 0.3, "ring": 0.3, "pinky": 0.2}
    along = {"thumb": -16.0, "index": -28.0, "middle": -8.0, "ring": 11.0, "pinky": 28.0}
    return {f: np.array([reach * np.cos(a), along[f], reach * np.sin(a)]) for f, a in around.items()}


@dataclass(frozen=True)
class _Nominal:
    """Where a grip is in the average right hand, before it is solved for."""

    grasp: Grasp
    origin_mm: tuple[float, float, float]
    x: tuple[float, float, float]
    z: tuple[float, float, float]


_NOMINAL: Final[Mapping[Contact, _Nominal]] = {
    "pinch": _Nominal("pinch", (-30.0, 100.0, -72.0), (0.15, 0.86, 0.48), (0.0, 0.48, -0.87)),
    "tripod": _Nominal("tripod", (-22.0, 98.0, -74.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
    "hold": _Nominal("tripod", (-14.0, 98.0, -74.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
    "round": _Nominal("tripod", (-20.0, 96.0, -74.0), (0.25, 0.84, 0.48), (0.0, 0.48, -0.87)),
    "wrap": _Nominal("power", (-8.0, 92.0, -58.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
}
_CONTACT_WEIGHT: Final = 1.0
_ANGLE_WEIGHT: Final = 4.0
_FRAME_WEIGHTS: Final = np.array([8.0, 8.0, 8.0, 0.08, 0.08, 0.08])
_NARROW_MM: Final = 25.0
_WIDE_MM: Final = 110.0
_NUM_STEPS: Final = 12
_NUDGE: Final = 1e-5


def _frame(nominal: _Nominal, offset: Float[np.ndarray, "6"]) -> Float64[np.ndarray, "4 4"]:
    """The grip frame in the wrist: the nominal one, turned by the first three numbers and moved by the others."""
    z = np.array(nominal.z) / np.linalg.norm(nominal.z)
    x = np.array(nominal.x) - z * (z @ nominal.x)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], axis=-1)
    return transforms.rigid(axes @ rotation(offset[:3]), np.array(nominal.origin_mm) + offset[3:])


def _solve(
    skeleton: HandSkeleton,
    nominal: _Nominal,
    contacts_mm: Mapping[str, Float64[np.ndarray, "3"]],
    start: Float64[np.ndarray, "26"],
    free_frame: bool,
) -> Float64[np.ndarray, "26"]:
    """Damped Gauss-Newton on contacts, held softly at the named grasp and place; angles are kept within limits."""
    free = np.arange(26) >= (0 if free_frame else 6)
    weights = np.concatenate([_FRAME_WEIGHTS, np.full(20, _ANGLE_WEIGHT)])
    value = start.copy()
    for _ in range(_NUM_STEPS):
        nudged = np.concatenate([value[None], value + _NUDGE * np.eye(26)[free]])
        misses = _misses_mm(skeleton, nominal, contacts_mm, nudged) * _CONTACT_WEIGHT
        slope = (misses[1:] - misses[0]).T / _NUDGE
        rows = np.concatenate([slope, np.diag(weights)[:, free]])
        rest = np.concatenate([misses[0], weights * (value - start)])
        value[free] -= np.linalg.lstsq(rows, rest, rcond=None)[0]
        value[6:] = clamp_to_limits(value[6:])
    return value


def _misses_mm(
    skeleton: HandSkeleton,
    nominal: _Nominal,
    contacts_mm: Mapping[str, Float64[np.ndarray, "3"]],
    values: Float64[np.ndarray, "n 26"],
) -> Float64[np.ndarray, "n m"]:
    """From the contacts to the fingertips, all in the wrist frame of the right hand."""
    still = np.broadcast_to(np.eye(4), (len(values), 4, 4))
    joints = forward_kinematics(skeleton, HandPose("right", still, values[:, 6:]))
    tips = joints[:, [4 * FINGERS.index(finger) for finger in contacts_mm]]
    frames = np.stack([_frame(nominal, value[:6]) for value in values])
    wanted = np.stack(list(contacts_mm.values())) @ frames[:, :3, :3].transpose(0, 2, 1) + frames[:, None, :3, 3]
    return np.asarray((tips - wanted).reshape(len(values), -1))
