"""The flesh of the average hand as one smooth implicit surface: a blended union of tapered capsules around the bones.

All lengths in mm, in the bone frames of `hands.kinematics`. Radii are chosen for the breadths usual in surveys of adult
hands (index finger 18-21 mm at the PIP joint, 16-19 mm at the DIP joint; palm 75-95 mm broad and 25-32 mm deep; wrist
52-62 mm broad and 35-42 mm deep), less what the blending adds.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.hands.kinematics import HandPose, HandSkeleton, finger_frames

BLEND_MM: Final = 2.2
"""Width of the transition between capsules: large enough for no seam, small enough to keep fingers apart."""

# A capsule is felt up to this distance; where none is, the field is constant at it.
_REACH_MM: Final = 14.0
_NOTHING: Final = float(np.exp(-_REACH_MM / BLEND_MM))

WRIST_FRAME: Final = (0, 0)
"""Finger and slot of `finger_frames` whose frame is the wrist's own."""

# A splayed, slightly bent hand: no finger touches another, and skinning has to bend the skin less in both directions.
_TEMPLATE_ANGLES_DEG: Final = ((14, -10, 8, 8), (9, 12, 15, 10), (1, 12, 15, 10), (-8, 12, 15, 10), (-16, 12, 15, 10))
TEMPLATE_ANGLES_RAD: Final[Float64[np.ndarray, "20"]] = np.deg2rad(_TEMPLATE_ANGLES_DEG).ravel()

# Radii at base, middle and distal joint and at the tip.
_FINGER_RADII_MM: Final = (
    (12.6, 10.4, 9.2, 7.6),
    (9.6, 8.3, 6.9, 6.0),
    (9.9, 8.5, 7.1, 6.2),
    (9.3, 7.9, 6.6, 5.8),
    (8.3, 6.9, 5.9, 5.1),
)


@dataclass(frozen=True)
class Capsule:
    """A tapered capsule in a bone frame; `width` and `depth` stretch it sideways and towards the nail."""

    finger: int
    slot: int
    start_mm: tuple[float, float, float]
    end_mm: tuple[float, float, float]
    start_radius_mm: float
    end_radius_mm: float
    width: float = 1.0
    depth: float = 1.0


def template_frames() -> Float64[np.ndarray, "5 7 4 4"]:
    """Bone frames of the average right hand in the pose in which its skin is built, in the wrist frame."""
    return finger_frames(HandSkeleton.average(), HandPose("right", np.eye(4), TEMPLATE_ANGLES_RAD))


def capsules() -> tuple[Capsule, ...]:
    """Return all the flesh of the average right hand."""
    fingers = [capsule for finger in range(5) for capsule in _finger(finger)]
    return (*fingers, *_palm(), *_thenar(), *_wrist())


def field_mm(
    points_mm: Float64[np.ndarray, "point 3"], flesh: tuple[Capsule, ...]
) -> tuple[Float64[np.ndarray, " point"], Float64[np.ndarray, "point 3"]]:
    """Return the approximate signed distance to the skin, negative inside, and its gradient.

    Smooth union by the logarithm of a sum of exponentials: f = -k ln Σ exp(-d / k), which does not depend on the order.
    """
    frames = template_frames()
    total, slope = np.full(len(points_mm), _NOTHING), np.zeros_like(points_mm)
    for capsule in flesh:
        frame = frames[capsule.finger, capsule.slot]
        distance, offset = _distance_mm(points_mm, capsule, frame)
        weight = np.exp(-distance / BLEND_MM)
        total += weight
        slope += (
            weight[:, None] * (offset / np.linalg.norm(offset, axis=1, keepdims=True)) @ _to_local(capsule, frame).T
        )
    return np.asarray(-BLEND_MM * np.log(total)), np.asarray(slope / total[:, None])


def sampled_field_mm(
    axes_mm: tuple[Float64[np.ndarray, " width"], Float64[np.ndarray, " height"], Float64[np.ndarray, " depth"]],
    flesh: tuple[Capsule, ...],
) -> Float64[np.ndarray, "width height depth"]:
    """Return `field_mm` on a rectilinear grid, evaluating each capsule only where it can be felt."""
    frames = template_frames()
    total = np.full([len(axis) for axis in axes_mm], _NOTHING)
    for capsule in flesh:
        frame = frames[capsule.finger, capsule.slot]
        ends = np.array([capsule.start_mm, capsule.end_mm]) @ frame[:3, :3].T + frame[:3, 3]
        margin = 1.2 * max(capsule.start_radius_mm, capsule.end_radius_mm) + _REACH_MM
        low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
        near = tuple(slice(*np.searchsorted(axis, (low[i], high[i]))) for i, axis in enumerate(axes_mm))
        block = [axis[part] for axis, part in zip(axes_mm, near, strict=True)]
        points = np.stack(np.meshgrid(*block, indexing="ij"), axis=-1)
        total[near] += np.exp(-_distance_mm(points, capsule, frame)[0] / BLEND_MM)
    return np.asarray(-BLEND_MM * np.log(total))


def _to_local(capsule: Capsule, frame: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3 3"]:
    """Matrix that takes row vectors of the wrist frame into the capsule's own frame, in which it is round."""
    return np.asarray(frame[:3, :3] / (capsule.width, 1.0, capsule.depth))


def _distance_mm(
    points_mm: Float64[np.ndarray, "*point 3"], capsule: Capsule, frame: Float64[np.ndarray, "4 4"]
) -> tuple[Float64[np.ndarray, "*point"], Float64[np.ndarray, "*point 3"]]:
    """Return the distance to a capsule and the offset from its axis in the capsule's own frame."""
    scale, to_local = np.array([capsule.width, 1.0, capsule.depth]), _to_local(capsule, frame)
    start, end = np.array(capsule.start_mm) / scale, np.array(capsule.end_mm) / scale
    axis = end - start
    local = points_mm @ to_local - (frame[:3, 3] @ to_local + start)
    share = np.clip(local @ axis / (axis @ axis), 0.0, 1.0)
    radius = capsule.start_radius_mm + share * (capsule.end_radius_mm - capsule.start_radius_mm)
    offset = local - share[..., None] * axis
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", offset, offset)) - radius), np.asarray(offset)


def _finger(finger: int) -> list[Capsule]:
    """Bones, joint heads, volar pads and the fingertip."""
    flesh = []
    radii, lengths = _FINGER_RADII_MM[finger], HandSkeleton.average().phalanges_mm[finger].tolist()
    for bone, slot in enumerate((2, 4, 6)):
        length, base, end, mean = lengths[bone], radii[bone], radii[bone + 1], 0.5 * (radii[bone] + radii[bone + 1])
        flesh.append(Capsule(finger, slot, (0, 0, 0), (0, length, 0), 0.92 * base, 0.92 * end, 1.03, 0.97))
        if bone > 0:
            head = 0.66 * base
            flesh.append(Capsule(finger, slot, (0, -2, 1.4), (0, 2, 1.4), head, head, 1.1))
        if bone < 2:
            flesh.append(Capsule(finger, slot, (0, 0.3 * length, 0), (0, 0.7 * length, 0), 0.86 * mean, 0.86 * mean))
        if bone == 2:
            low = -0.2 * mean
            flesh.append(
                Capsule(finger, slot, (0, 0.35 * length, low), (0, length, low), 0.84 * mean, 0.84 * end, 1.12)
            )
        elif finger > 0 or bone > 0:
            low, pad = -0.36 * mean, 0.76 * mean
            flesh.append(Capsule(finger, slot, (0, 0.28 * length, low), (0, 0.74 * length, low), pad, pad, 1.1))
    return flesh


def _palm() -> list[Capsule]:
    """Metacarpals, the flesh between and below them, the knuckles and the heel on the little finger's side."""
    bases = HandSkeleton.average().bases_mm
    flesh = []
    for finger in (1, 2, 3, 4):
        x, y, z = bases[finger].tolist()
        radius = _FINGER_RADII_MM[finger][0]
        flesh.append(Capsule(finger, 0, (0.55 * x, 16, -2), (x, y, z - 1), 10.5, 0.88 * radius))
        flesh.append(Capsule(finger, 0, (0.6 * x, 24, -10), (x, y - 3, z - 8), 9.0, 0.74 * radius, 1.15))
        flesh.append(Capsule(finger, 0, (x, y - 4, z + 2.5), (x, y + 1, z + 2.5), 0.70 * radius, 0.70 * radius))
        # Flesh of the finger's root, which the webs hang between.
        flesh.append(Capsule(finger, 2, (0, 4, -2), (0, 17, -2), 0.80 * radius, 0.74 * radius, 1.1))
    for finger in (1, 2, 3):
        x, y, z = (0.5 * (bases[finger] + bases[finger + 1])).tolist()
        flesh.append(Capsule(finger, 0, (0.55 * x, 20, -2), (x, y - 4, z - 2), 9.0, 7.5, 1.1))
    flesh.append(Capsule(4, 0, (19, 14, -11), (33, 62, -11), 13.0, 9.5))
    flesh.append(Capsule(4, 0, (27, 26, -7), (37, 68, -7), 10.5, 8.5))
    return flesh


def _thenar() -> list[Capsule]:
    """The ball of the thumb and the web to the index finger."""
    thumb = float(HandSkeleton.average().phalanges_mm[0, 0])
    flesh = [
        Capsule(0, 2, (0.0, 2, -4), (1.0, 0.80 * thumb, -3), 13.5, 10.5),
        Capsule(*WRIST_FRAME, (-16, 24, -15), (-22, 50, -17), 12.5, 9.0),
        Capsule(*WRIST_FRAME, (-10, 40, -10), (-20, 66, -9), 10.0, 9.0),
    ]
    frames = template_frames()
    metacarpal, index = frames[0, 2], HandSkeleton.average().bases_mm[1]
    for share, radius in ((0.3, 10.0), (0.5, 8.5), (0.7, 7.0), (0.85, 5.5)):
        on_thumb = metacarpal[:3, 3] + share * thumb * metacarpal[:3, 1] - 2.0 * metacarpal[:3, 2]
        on_index = (0.25 + 0.55 * share) * index + (0.0, 6.0, -5.0)
        flesh.append(Capsule(*WRIST_FRAME, _triple(on_thumb), _triple(on_index), radius, radius))
    return flesh


def _wrist() -> list[Capsule]:
    """Carpus, wrist and the stump of the forearm, which a sleeve or forearm overlaps."""
    return [
        Capsule(*WRIST_FRAME, (0, 22, -5), (0, 8, -4), 15.0, 16.0, 1.75),
        Capsule(*WRIST_FRAME, (0, 10, -3), (0, -14, -3), 16.5, 17.0, 1.52),
        Capsule(*WRIST_FRAME, (0, -12, -3), (0, -48, -4), 17.0, 20.0, 1.5),
        Capsule(*WRIST_FRAME, (17, -16, 5), (17, -10, 5), 8.0, 8.0),
    ]


def _triple(point: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z
