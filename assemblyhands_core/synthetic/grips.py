"""Where a hand takes hold of things: contacts of fingertips solved for, from a named grasp as the start.

Grip frame, mm: the origin lies between the thumb and the fingers, x points from the thumb to the fingers, z the way the
hand came to take hold (so that the hand is on the side of -z), y = z × x. `T_part_from_grip` says where a part may be
gripped, `T_wrist_from_grip` where that is in a hand; the left hand's is the mirror image S T S, S = diag(-1, 1, 1, 1).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64

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
FLESH_MM: Final[Float64[np.ndarray, "21"]] = np.array(
    [*(6.5, 9.0, 11.0, 13.0), *(6.0, 7.0, 8.0, 11.0) * 3, *(5.5, 6.5, 7.5, 10.0), 18.0]
)
"""From each joint to the skin around it, roughly."""
FLESH_MM.flags.writeable = False
OPENING_MM: Final = 16.0
"""How much further from the object each finger is before it touches."""
LEANS_RAD: Final = ((0.0, 0.0), (0.45, 0.0), (-0.45, 0.0), (0.0, 0.4), (0.0, -0.4))
"""The hand may lean against the grip: about the axis through the contacts (x) and across it (y)."""


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
    """A grip in a hand: where it is, and how the fingers are bent when they touch and before."""

    T_wrist_from_grip: Float64[np.ndarray, "4 4"]
    closed_rad: Float64[np.ndarray, "20"]
    open_rad: Float64[np.ndarray, "20"]


def solve_grips(skeleton: HandSkeleton, kind: GripKind, hand: Hand) -> tuple[HandGrip, ...]:
    """Find the places of a grip in a hand and the bend of the fingers that bring the fingertips to their contacts.

    Args:
        skeleton: The hand's lengths.
        kind: What is gripped.
        hand: Which hand.

    Returns:
        One grip for each of `LEANS_RAD`, angles within the limits; open ones have the fingers further apart.
    """
    nominal = np.stack([_nominal_frame(_NOMINAL[kind.contact], lean) for lean in LEANS_RAD])
    spread = np.clip((kind.width_mm - _NARROW_MM) / _WIDE_MM, 0.0, 1.0)
    named = grasp_angles_rad(_NOMINAL[kind.contact].grasp)
    named = blended_grasps_rad(named, grasp_angles_rad("open"), spread)
    start = np.tile(np.concatenate([np.zeros(6), named]), (len(nominal), 1))
    closed = _solve(skeleton, nominal, _contacts_mm(kind), start, num_fixed=0)
    wider = replace(kind, width_mm=kind.width_mm + 2 * OPENING_MM)
    opened = _solve(skeleton, nominal, _contacts_mm(wider), closed, num_fixed=6)
    frames = _moved(nominal, closed[:, :6])
    if hand == "left":
        frames = MIRROR @ frames @ MIRROR
    return tuple(
        HandGrip(frame, clamp_to_limits(one[6:]), clamp_to_limits(other[6:]))
        for frame, one, other in zip(frames, closed, opened, strict=True)
    )


def _contacts_mm(kind: GripKind) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Where the joints in the touching fingertips have to be, in the grip frame of a right hand."""
    reach = kind.width_mm / 2 + PAD_MM
    if kind.contact == "pinch":
        return {"thumb": np.array([-reach, 0.0, 0.0]), "index": np.array([reach, 0.0, 0.0])}
    if kind.contact == "tripod":
        sides = {"index": np.array([reach, -9.0, 0.0]), "middle": np.array([reach, 9.0, 0.0])}
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
    "pinch": _Nominal("tripod", (-30.0, 100.0, -72.0), (0.15, 0.86, 0.48), (0.0, 0.48, -0.87)),
    "tripod": _Nominal("tripod", (-22.0, 98.0, -74.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
    "hold": _Nominal("tripod", (-14.0, 98.0, -74.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
    "round": _Nominal("tripod", (-20.0, 96.0, -74.0), (0.25, 0.84, 0.48), (0.0, 0.48, -0.87)),
    "wrap": _Nominal("power", (-8.0, 92.0, -58.0), (0.2, 0.85, 0.48), (0.0, 0.48, -0.87)),
}
_ANGLE_WEIGHT: Final = 4.0
_FRAME_WEIGHTS: Final = np.array([8.0, 8.0, 8.0, 0.08, 0.08, 0.08])
_WEIGHTS: Final = np.concatenate([_FRAME_WEIGHTS, np.full(20, _ANGLE_WEIGHT)])
_NARROW_MM: Final = 25.0
_WIDE_MM: Final = 110.0
_NUM_STEPS: Final = 14
_NUDGE: Final = 1e-5


def _nominal_frame(nominal: _Nominal, lean_rad: tuple[float, float]) -> Float64[np.ndarray, "4 4"]:
    """The grip frame in the average wrist, turned about its x and y axes."""
    z = np.array(nominal.z) / np.linalg.norm(nominal.z)
    x = np.array(nominal.x) - z * (z @ nominal.x)
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], axis=-1) @ rotation(np.array([*lean_rad, 0.0]))
    return transforms.rigid(axes, np.array(nominal.origin_mm))


def _moved(
    nominal: Float64[np.ndarray, "*n 4 4"], offset: Float64[np.ndarray, "*n 6"]
) -> Float64[np.ndarray, "*n 4 4"]:
    """Turn frames by the first three numbers (small angles; made a rotation again) and move them by the others."""
    frames = nominal.copy()
    x, y, z = np.moveaxis(offset[..., :3], -1, 0)
    one, zero = np.ones_like(x), np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    # Cayley's map: (I - S/2)^-1 (I + S/2) is a rotation for any skew S and equals exp(S) up to the third order.
    eye = one[..., None, None] * np.eye(3)
    frames[..., :3, :3] = nominal[..., :3, :3] @ np.linalg.solve(eye - skew / 2, eye + skew / 2)
    frames[..., :3, 3] += offset[..., 3:]
    return frames


def _solve(
    skeleton: HandSkeleton,
    nominal: Float64[np.ndarray, "lean 4 4"],
    contacts_mm: Mapping[str, Float64[np.ndarray, "3"]],
    start: Float64[np.ndarray, "lean 26"],
    num_fixed: int,
) -> Float64[np.ndarray, "lean 26"]:
    """Gauss-Newton on contacts, held softly at the named grasp and place; angles are kept within their limits."""
    value, free = start.copy(), np.arange(num_fixed, 26)
    nudges = np.concatenate([np.zeros((1, 26)), _NUDGE * np.eye(26)[free]])
    stuck = np.zeros((len(start), len(free)), dtype=bool)
    for _ in range(_NUM_STEPS):
        misses = _misses_mm(skeleton, nominal, contacts_mm, value[:, None] + nudges)
        # What is stuck at a limit does not count on moving, so that the rest makes up for it.
        slope = (misses[:, 1:] - misses[:, :1]) / _NUDGE * ~stuck[..., None]
        pull = (slope @ misses[:, 0, :, None])[..., 0] + _WEIGHTS[free] ** 2 * (value - start)[:, free] * ~stuck
        curvature = slope @ np.swapaxes(slope, 1, 2) + np.diag(_WEIGHTS[free] ** 2)
        wanted = value.copy()
        wanted[:, free] -= np.linalg.solve(curvature, pull[..., None])[..., 0]
        value = np.concatenate([wanted[:, :6], clamp_to_limits(wanted[:, 6:])], axis=1)
        stuck |= (wanted != value)[:, free]
    return value


def _misses_mm(
    skeleton: HandSkeleton,
    nominal: Float64[np.ndarray, "lean 4 4"],
    contacts_mm: Mapping[str, Float64[np.ndarray, "3"]],
    values: Float64[np.ndarray, "lean n 26"],
) -> Float64[np.ndarray, "lean n m"]:
    """From the contacts to the fingertips, all in the wrist frame of the right hand."""
    still = np.broadcast_to(np.eye(4), (*values.shape[:2], 4, 4))
    joints = forward_kinematics(skeleton, HandPose("right", still, values[..., 6:]))
    tips = joints[..., [4 * FINGERS.index(finger) for finger in contacts_mm], :]
    frames = _moved(np.broadcast_to(nominal[:, None], still.shape), values[..., :6])
    wanted = np.stack(list(contacts_mm.values())) @ np.swapaxes(frames[..., :3, :3], -1, -2)
    wanted = wanted + frames[..., None, :3, 3]
    return np.asarray((tips - wanted).reshape(*values.shape[:2], -1))
