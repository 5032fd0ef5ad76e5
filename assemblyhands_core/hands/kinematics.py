"""The hand as a kinematic chain: bone lengths, joint angles with their anatomical limits, and the 21 joints they give.

Conventions, stated once here
-----------------------------
* **Wrist frame**, the same words for both hands: palm down and fingers forward, x points to the right, y forward along
  the middle metacarpal, z up out of the back of the hand; origin in the wrist joint. The thumb of the right hand is
  therefore at -x. `HandSkeleton` describes a right hand; a left hand is its exact mirror image in x.
* **Angles**: `(20,)` rad = 5 fingers × (abduction, base flexion, middle flexion, distal flexion), names in
  `ANGLE_NAMES`. Flexion is positive towards the palm, abduction of a finger positive towards the thumb, abduction of
  the thumb positive away from the palm (palmar abduction). Zero is the straight finger at its natural splay.
* **Bone frames** have y along the bone and z on the side of the nail; flexion turns about -x.
* Each base joint flexes first about an axis of the metacarpal, then abducts about an axis of the phalanx, as in the
  recommendation of the International Society of Biomechanics for the hand (Wu et al. 2005).
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.hands.joints import BONES, FINGERS, WRIST, Hand

NUM_ANGLES: Final = 20
FRAMES_PER_FINGER: Final = 7
"""Metacarpal, then for each of three joints the frame half way through its bend and the frame of the bone beyond."""

_DEGREES_OF_FREEDOM: Final = ("abduction", "base_flexion", "middle_flexion", "distal_flexion")
ANGLE_NAMES: Final = tuple(f"{finger}_{freedom}" for finger in FINGERS for freedom in _DEGREES_OF_FREEDOM)

MIRROR: Final[Float64[np.ndarray, "4 4"]] = np.diag([-1.0, 1.0, 1.0, 1.0])

# Active ranges of clinical goniometry, on which handbooks differ by 10°: MCP 20° of hyperextension to 90°, PIP 0 to
# 110°, DIP 0 to 80°, ±20° sideways. Thumb: Cooney et al. 1981 measured 53° of flexion and 42° of abduction in the
# carpometacarpal joint, here around the resting thumb; MCP and IP may overextend a little.
_FINGER_LIMITS_DEG: Final = ((-20.0, 20.0), (-20.0, 90.0), (0.0, 110.0), (0.0, 80.0))
_THUMB_LIMITS_DEG: Final = ((-15.0, 30.0), (-20.0, 35.0), (-10.0, 60.0), (-15.0, 80.0))
JOINT_LIMITS_RAD: Final[Float64[np.ndarray, "20 2"]] = np.deg2rad([*_THUMB_LIMITS_DEG, *(_FINGER_LIMITS_DEG * 4)])
JOINT_LIMITS_RAD.flags.writeable = False

# Mean adult lengths in mm, base to tip, without the pulp of the tip (Buryanov & Kotiuk 2010, radiographs of 66 adults),
# taken for a hand of this length; the carpus is part of the positions of the base joints.
AVERAGE_HAND_LENGTH_MM: Final = 188.0
_PHALANGES_MM: Final = (
    (46.2, 31.6, 21.7),
    (39.8, 22.4, 15.8),
    (44.6, 26.3, 17.4),
    (41.4, 25.7, 17.3),
    (32.7, 18.1, 16.0),
)
_BASES_MM: Final = ((-23.0, 24.0, -10.0), (-24.0, 91.0, -1.0), (-2.0, 93.0, 2.0), (18.0, 86.0, 0.0), (35.0, 77.0, -5.0))
# Splay of the straight fingers, and the roll that makes bent fingers point at the scaphoid (the transverse arch).
_SPLAY_DEG: Final = (3.0, 0.0, -3.5, -8.0)
_ROLL_DEG: Final = (-5.0, 0.0, 6.0, 12.0)
_THUMB_DIRECTION: Final = (-0.50, 0.78, -0.38)
_THUMB_NAIL: Final = (-0.83, -0.35, 0.42)

# How far the carpometacarpal joints of ring and little finger follow the bend of their fingers (hollow of the hand),
# and how far the thumb turns its pad to the fingers as it crosses the palm and leaves it (17° in the saddle joint after
# Cooney, about as much again in the MCP joint), by its flexion and by its abduction.
_CUPPING: Final = np.array([0.0, 0.0, 0.0, 0.08, 0.16])
_PRONATION: Final = np.array([[-0.6, -0.4]] + 4 * [[0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class HandSkeleton:
    """The constant lengths of a right hand (a left hand is its mirror image).

    Attributes:
        bases_mm: Base joint of each finger in the wrist frame (thumb: CMC, others: MCP), all angles zero.
        phalanges_mm: Lengths of the three bones of each finger from base to tip; the last ends in the tip joint.
        wrist_from_finger: Rotation of each finger's first bone at zero angles; columns are the axes of the bone.
    """

    bases_mm: Float[np.ndarray, "5 3"]
    phalanges_mm: Float[np.ndarray, "5 3"]
    wrist_from_finger: Float[np.ndarray, "5 3 3"]

    @classmethod
    def average(cls, hand_length_mm: float = AVERAGE_HAND_LENGTH_MM) -> Self:
        """Return the hand of mean adult proportions with this length from wrist to middle fingertip in mm."""
        scale = hand_length_mm / AVERAGE_HAND_LENGTH_MM
        return cls(scale * np.array(_BASES_MM), scale * np.array(_PHALANGES_MM), _zero_rotations())

    @property
    def bone_lengths_mm(self) -> Float64[np.ndarray, "20"]:
        """Lengths in the order of `joints.BONES`."""
        base = np.linalg.norm(self.bases_mm, axis=1, keepdims=True)
        return np.concatenate([self.phalanges_mm[:, ::-1], base], axis=1).ravel()


@dataclass(frozen=True, eq=False)
class HandPose:
    """Where a hand is and how it is bent; leading axes, if any, are instants.

    Attributes:
        hand: Which hand; a left hand bends like the right one in the mirror.
        T_world_from_wrist: Rigid, mm.
        angles_rad: In the order of `ANGLE_NAMES`.
    """

    hand: Hand
    T_world_from_wrist: Float[np.ndarray, "*batch 4 4"]
    angles_rad: Float[np.ndarray, "*batch 20"]


def clamp_to_limits(angles_rad: Float[np.ndarray, "*batch 20"]) -> Float[np.ndarray, "*batch 20"]:
    """Return the nearest angles that a hand can reach."""
    return np.asarray(np.clip(angles_rad, JOINT_LIMITS_RAD[:, 0], JOINT_LIMITS_RAD[:, 1]))


def is_within_limits(angles_rad: Float[np.ndarray, "*batch 20"], tolerance_rad: float = 1e-9) -> bool:
    """Say whether a hand can reach all these angles."""
    return bool(np.abs(clamp_to_limits(angles_rad) - angles_rad).max(initial=0.0) <= tolerance_rad)


def mirrored(pose: HandPose) -> HandPose:
    """Return the pose of the other hand that is this one's mirror image in the plane x = 0 of the world.

    Joints and skin are mirrored exactly and mirroring twice gives the same bytes: T' = S T S, S = diag(-1, 1, 1, 1).
    """
    other: Hand = "left" if pose.hand == "right" else "right"
    return HandPose(other, _conjugated(pose.T_world_from_wrist), pose.angles_rad)


def forward_kinematics(skeleton: HandSkeleton, pose: HandPose) -> Float64[np.ndarray, "*batch 21 3"]:
    """Return the 21 joints in world mm, in the order of `joints.JOINT_NAMES`."""
    frames = finger_frames(skeleton, pose)
    bones = frames[..., 2::2, :3, :]
    tips = bones[..., 2, :, 3] + bones[..., 2, :, 1] * skeleton.phalanges_mm[:, 2:]
    # Tip first, then the origins of the bones from the last to the first.
    chains = np.concatenate([tips[..., None, :], bones[..., ::-1, :, 3]], axis=-2)
    wrist = np.asarray(pose.T_world_from_wrist, dtype=np.float64)[..., None, :3, 3]
    return np.concatenate([chains.reshape(*chains.shape[:-3], WRIST, 3), wrist], axis=-2)


def finger_frames(skeleton: HandSkeleton, pose: HandPose) -> Float64[np.ndarray, "*batch 5 7 4 4"]:
    """Return T_world_from_bone of all bones of all fingers, mm.

    Seven frames a finger: the metacarpal in the wrist (of the thumb: the carpus itself), then for base, middle and
    distal joint the frame half way through the bend, which the skin around the joint follows, and the bone beyond.
    """
    frames = _local_frames(skeleton, np.asarray(pose.angles_rad, dtype=np.float64))
    if pose.hand == "left":
        frames = _conjugated(frames)
    return np.asarray(pose.T_world_from_wrist[..., None, None, :, :] @ frames)


def bone_lengths_mm(joints_mm: Float[np.ndarray, "*batch 21 3"]) -> Float[np.ndarray, "*batch 20"]:
    """Measure the lengths of `joints.BONES` on joints in any frame."""
    child, parent = np.array(BONES).T
    return np.asarray(np.linalg.norm(joints_mm[..., child, :] - joints_mm[..., parent, :], axis=-1))


def _local_frames(
    skeleton: HandSkeleton, angles_rad: Float[np.ndarray, "*batch 20"]
) -> Float64[np.ndarray, "*batch 5 7 4 4"]:
    """The frames of `finger_frames` in the wrist frame of a right hand."""
    abduction, *flexion = np.moveaxis(angles_rad.reshape(*angles_rad.shape[:-1], 5, 4), -1, 0)
    rotation = _about_x(-_CUPPING * flexion[0])
    origin = np.zeros((*abduction.shape, 3))
    frames = [_stacked(rotation, origin)]
    step = skeleton.bases_mm
    for joint in range(3):
        origin = origin + np.einsum("...ij,...j->...i", rotation, step)
        zero = rotation @ skeleton.wrist_from_finger if joint == 0 else rotation
        for share in (0.5, 1.0):
            rotation = zero @ _about_x(-share * flexion[joint])
            if joint == 0:
                pronation = _PRONATION[:, 0] * flexion[0] + _PRONATION[:, 1] * abduction
                rotation = rotation @ _about_z(share * abduction) @ _about_y(share * pronation)
            frames.append(_stacked(rotation, origin))
        step = skeleton.phalanges_mm[:, joint, None] * np.array([0.0, 1.0, 0.0])
    return np.stack(frames, axis=-3)


def _zero_rotations() -> Float64[np.ndarray, "5 3 3"]:
    """Rotations of the first bones at zero angles."""
    y = np.array(_THUMB_DIRECTION) / np.linalg.norm(_THUMB_DIRECTION)
    x = np.cross(y, _THUMB_NAIL)
    x /= np.linalg.norm(x)
    thumb = np.stack([x, y, np.cross(x, y)], axis=-1)
    fingers = _about_z(np.deg2rad(_SPLAY_DEG)) @ _about_y(np.deg2rad(_ROLL_DEG))
    return np.concatenate([thumb[None], fingers])


def _conjugated(transforms: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """S T S: only signs change, so that it is exact."""
    return np.asarray(transforms * np.outer(np.diag(MIRROR), np.diag(MIRROR)))


def _stacked(
    rotation: Float[np.ndarray, "*batch 3 3"], origin: Float[np.ndarray, "*batch 3"]
) -> Float64[np.ndarray, "*batch 4 4"]:
    transforms = np.zeros((*origin.shape[:-1], 4, 4))
    transforms[..., :3, :3] = rotation
    transforms[..., :3, 3] = origin
    transforms[..., 3, 3] = 1.0
    return transforms


def _turn(angle_rad: Float[np.ndarray, "*batch"], axis: int) -> Float64[np.ndarray, "*batch 3 3"]:
    """Right-handed rotation about a coordinate axis."""
    rotation = np.zeros((*angle_rad.shape, 3, 3))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[..., axis, axis] = 1.0
    rotation[..., first, first] = rotation[..., second, second] = np.cos(angle_rad)
    rotation[..., second, first] = np.sin(angle_rad)
    rotation[..., first, second] = -rotation[..., second, first]
    return rotation


def _about_x(angle_rad: Float[np.ndarray, "*batch"]) -> Float64[np.ndarray, "*batch 3 3"]:
    return _turn(angle_rad, 0)


def _about_y(angle_rad: Float[np.ndarray, "*batch"]) -> Float64[np.ndarray, "*batch 3 3"]:
    return _turn(angle_rad, 1)


def _about_z(angle_rad: Float[np.ndarray, "*batch"]) -> Float64[np.ndarray, "*batch 3 3"]:
    return _turn(angle_rad, 2)
