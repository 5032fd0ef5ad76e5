"""A subject's hand as one closed skin that follows the joints."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from jaxtyping import Float, Float64, Int32, UInt8

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import FINGERS, Hand
from assemblyhands_core.hands.kinematics import FRAMES_PER_FINGER, HandPose, HandSkeleton, finger_frames
from assemblyhands_core.synthetic.hand_colour import skin_albedo
from assemblyhands_core.synthetic.hand_field import TEMPLATE_ANGLES_RAD
from assemblyhands_core.synthetic.hand_shape import HandShape
from assemblyhands_core.synthetic.hand_template import HandTemplate, hand_template
from assemblyhands_core.synthetic.hand_weights import FOREARM, NUM_BONES

PARTS: Final = ("palm", *FINGERS, "nail", "forearm")
"""What `HandMesh.part` counts."""

_MIRROR: Final = np.array([-1.0, 1.0, 1.0])
_NEAREST_COS_TO_FOLDED: Final = -0.95


@dataclass(frozen=True, eq=False)
class HandMesh:
    """The skin of one hand of a subject. All hands share their topology: vertex i is the same spot in every one.

    Attributes:
        hand: Which hand.
        skeleton: The bones inside.
        right_rest_mm: Vertices of the subject's right hand in its wrist frame in the template pose.
        faces: Triangles, counter-clockwise seen from outside; every edge lies in exactly two.
        weights: Share of each bone in the motion of each vertex, see `hand_weights`; rows sum to one.
        T_bone_from_rest: Takes `right_rest_mm` into the frame of each bone.
        albedo: Linear RGB, 0 to 1.
        part: Index into `PARTS`.
    """

    hand: Hand
    skeleton: HandSkeleton
    right_rest_mm: Float64[np.ndarray, "vertex 3"]
    faces: Int32[np.ndarray, "face 3"]
    weights: Float64[np.ndarray, "vertex bone"]
    T_bone_from_rest: Float64[np.ndarray, "bone 4 4"]
    albedo: Float64[np.ndarray, "vertex 3"]
    part: UInt8[np.ndarray, " vertex"]

    @classmethod
    def of(cls, shape: HandShape, hand: Hand) -> Self:
        """Adapt the template to a subject's hand; the left is the mirror image of the right."""
        template = hand_template()
        bones = _bone_frames(shape.skeleton, TEMPLATE_ANGLES_RAD)
        return cls(
            hand=hand,
            skeleton=shape.skeleton,
            right_rest_mm=_adapted(template, shape, bones),
            faces=template.faces if hand == "right" else np.ascontiguousarray(template.faces[:, ::-1]),
            weights=template.weights,
            T_bone_from_rest=np.linalg.inv(bones),
            albedo=skin_albedo(template.vertices_mm, template.marks, shape.tone),
            part=_parts(template),
        )

    def skin(
        self, pose: HandPose, elbow_world_mm: Float[np.ndarray, "3"] | None = None
    ) -> Float64[np.ndarray, "vertex 3"]:
        """Return the vertices in world mm of the hand in a pose.

        Args:
            pose: Of this hand, a single instant.
            elbow_world_mm: Turns the stump of the forearm about the wrist towards the elbow. Without it the forearm
                continues the hand.

        Raises:
            ValueError: The pose is of the other hand, or the forearm would be folded onto the hand.
        """
        if pose.hand != self.hand:
            raise ValueError(f"A {self.hand} hand cannot take the pose of a {pose.hand} hand: mirror the pose first.")
        bones = _bone_frames(self.skeleton, pose.angles_rad)
        if elbow_world_mm is not None:
            elbow = transforms.apply(transforms.inverse(pose.T_world_from_wrist), elbow_world_mm)
            bones[FOREARM, :3, :3] = _forearm_rotation(self._as_right(elbow))
        vertices = self._as_right(_blended(self.right_rest_mm, self.weights, bones @ self.T_bone_from_rest))
        return transforms.apply(pose.T_world_from_wrist, vertices)

    def _as_right(self, points_mm: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 3"]:
        """Between this hand's wrist frame and that of the right hand, either way."""
        return points_mm if self.hand == "right" else points_mm * _MIRROR


def _bone_frames(skeleton: HandSkeleton, angles_rad: Float[np.ndarray, "20"]) -> Float64[np.ndarray, "36 4 4"]:
    """T_wrist_from_bone of a right hand: all frames of the fingers, then the forearm, in line with the hand."""
    fingers = finger_frames(skeleton, HandPose("right", np.eye(4), angles_rad))
    return np.concatenate([fingers.reshape(FOREARM, 4, 4), np.eye(4)[None]])


def _adapted(
    template: HandTemplate, shape: HandShape, bones: Float64[np.ndarray, "36 4 4"]
) -> Float64[np.ndarray, "vertex 3"]:
    """Stretch the template along and across each bone to the subject's, blended as in skinning."""
    stretch = np.zeros((NUM_BONES, 4, 4))
    stretch[:, range(3), range(3)] = _stretch(shape)
    stretch[:, 3, 3] = 1.0
    template_bones = _bone_frames(HandSkeleton.average(), TEMPLATE_ANGLES_RAD)
    return _blended(template.vertices_mm, template.weights, bones @ stretch @ np.linalg.inv(template_bones))


def _stretch(shape: HandShape) -> Float64[np.ndarray, "36 3"]:
    """Scale of every bone's flesh sideways, along and in depth; half way through a joint the mean of its bones."""
    along = shape.skeleton.phalanges_mm / HandSkeleton.average().phalanges_mm
    stretch = np.empty((5, FRAMES_PER_FINGER, 3))
    stretch[:, 0] = shape.palm_scale
    stretch[:, 2::2] = shape.girth_scale[:, None, None]
    stretch[:, 2::2, 1] = along
    stretch[:, 1::2] = 0.5 * (stretch[:, :-1:2] + stretch[:, 2::2])
    return np.concatenate([stretch.reshape(FOREARM, 3), shape.palm_scale[None]])


def _blended(
    points_mm: Float64[np.ndarray, "vertex 3"],
    weights: Float64[np.ndarray, "vertex bone"],
    motions: Float64[np.ndarray, "bone 4 4"],
) -> Float64[np.ndarray, "vertex 3"]:
    """Linear blend skinning: x' = Σ w_b M_b x."""
    moved = (weights @ motions[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
    return np.asarray(np.einsum("vij,vj->vi", moved[:, :, :3], points_mm) + moved[:, :, 3])


def _forearm_rotation(elbow_mm: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """The smallest rotation that takes the wrist's -y to the direction of the elbow (Rodrigues' formula)."""
    direction = elbow_mm / np.linalg.norm(elbow_mm)
    straight = np.array([0.0, -1.0, 0.0])
    cosine = float(straight @ direction)
    if cosine < _NEAREST_COS_TO_FOLDED:
        raise ValueError(
            f"The elbow lies at {elbow_mm.round().tolist()} mm in the wrist frame, in line with the fingers: "
            "swap wrist and elbow, or turn the hand."
        )
    x, y, z = np.cross(straight, direction)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))


def _parts(template: HandTemplate) -> UInt8[np.ndarray, " vertex"]:
    """Label each vertex by the bones that move it most; nails by their colour."""
    chains = template.weights[:, :FOREARM].reshape(-1, 5, FRAMES_PER_FINGER)
    is_metacarpal = np.arange(FRAMES_PER_FINGER) < np.array([[1], [2], [2], [2], [2]])
    palm = (chains * is_metacarpal).sum(axis=(1, 2))
    fingers = (chains * ~is_metacarpal).sum(axis=2)
    part = np.concatenate([palm[:, None], fingers], axis=1).argmax(axis=1)
    part = np.where(template.marks.nail > 0.5, PARTS.index("nail"), part)
    return np.where(template.weights[:, FOREARM] > 0.5, PARTS.index("forearm"), part).astype(np.uint8)
