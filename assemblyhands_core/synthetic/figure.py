"""The drawn person: trunk, head with or without a headset, and sleeved arms around the bones of `person`.

Every body is a closed mesh made once and moved rigidly; only the hands' skins (`hand_mesh`) change shape.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, Int32

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.synthetic.bodies import Body, Color
from assemblyhands_core.synthetic.hand_mesh import PARTS, HandMesh
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.motion import rotation
from assemblyhands_core.synthetic.person import Subject
from assemblyhands_core.synthetic.solids import Box, Lathe, Solid, cylinder, tapered_capsule
from assemblyhands_core.synthetic.take import State

HAND_IDS: Final[Mapping[Hand, int]] = {"right": 1, "left": 2}
JOINT_OWNERS: Final = np.repeat([HAND_IDS["right"], HAND_IDS["left"]], NUM_JOINTS)
"""The hand that each of `State.joints_world_mm` belongs to."""
ARM_IDS: Final[Mapping[Hand, int]] = {"right": 3, "left": 4}
TRUNK_ID: Final = 5
HEAD_ID: Final = 6
HEADSET_ID: Final = 7

_EYE_WHITE: Final[Color] = (0.75, 0.74, 0.72)
_DARK: Final[Color] = (0.02, 0.018, 0.016)
_VISOR: Final[Color] = (0.03, 0.03, 0.035)
_SLEEVE_END: Final = {"short": 0.62, "half": 1.0, "long": 1.0}


@dataclass(frozen=True, eq=False)
class Shape:
    """A body in its own frame.

    Attributes:
        name: Of the body.
        object_id: Of the body.
        vertices_mm: In the frame that it is moved with.
        faces: As of `Body`.
        albedo: As of `Body`.
        gloss: As of `Body`.
        metallic: As of `Body`.
        texture: As of `Body`.
    """

    name: str
    object_id: int
    vertices_mm: Float32[np.ndarray, "vertex 3"]
    faces: Int32[np.ndarray, "face 3"]
    albedo: Float32[np.ndarray, "vertex 3"]
    gloss: float = 0.15
    metallic: float = 0.0
    texture: Texture | None = None

    @classmethod
    def of(
        cls,
        name: str,
        object_id: int,
        solid: Solid,
        color: Color,
        T_frame_from_solid: Float64[np.ndarray, "4 4"] | None = None,
        scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
        gloss: float = 0.15,
        texture: Texture | None = None,
    ) -> "Shape":
        """Take a solid, stretched in its own frame, then placed in the body's."""
        vertices = solid.mesh.vertices_mm * scale
        if T_frame_from_solid is not None:
            vertices = transforms.apply(T_frame_from_solid, vertices)
        albedo = np.tile(np.array(color, dtype=np.float32), (len(vertices), 1))
        faces = solid.mesh.faces.astype(np.int32)
        return cls(name, object_id, vertices.astype(np.float32), faces, albedo, gloss, texture=texture)

    def moved(self, T_world_from_frame: Float64[np.ndarray, "4 4"]) -> Body:
        """Return the body at a pose; textures stay anchored in its own frame."""
        return Body(
            self.name,
            self.object_id,
            transforms.apply(T_world_from_frame, self.vertices_mm),
            self.faces,
            self.albedo,
            self.gloss,
            self.metallic,
            texture=self.texture,
            rest_mm=self.vertices_mm,
        )


@dataclass(frozen=True, eq=False)
class Figure:
    """A subject ready to be drawn.

    Attributes:
        hands: Skins.
        trunk: Shapes in the trunk's frame.
        head: Shapes in the headset's frame.
        arms: For each hand shapes along the upper arm and along the forearm (z from joint to joint).
        shoulders: The yoke of the shirt, z from the left shoulder to the right.
        neck: z from the base of the neck to the head.
    """

    hands: Mapping[Hand, HandMesh]
    trunk: tuple[Shape, ...]
    head: tuple[Shape, ...]
    arms: Mapping[Hand, tuple[tuple[Shape, ...], tuple[Shape, ...]]]
    shoulders: Shape
    neck: Shape

    @classmethod
    def of(cls, subject: Subject, has_headset: bool) -> "Figure":
        """Make all shapes of a subject."""
        hands = {hand: HandMesh.of(subject.hand_shape, hand) for hand in HANDS}
        mean = hands["right"].albedo[hands["right"].part == PARTS.index("forearm")].mean(axis=0)
        skin: Color = (float(mean[0]), float(mean[1]), float(mean[2]))
        cloth, scale = _cloth(subject), subject.scale
        trunk = Shape.of(
            "trunk", TRUNK_ID, Lathe(_TRUNK, 28), subject.shirt, _UPRIGHT, _stretch(0.62, scale), texture=cloth
        )
        yoke = tapered_capsule(56.0 * scale, 56.0 * scale, 344.0 * scale)
        return cls(
            hands=hands,
            trunk=(trunk,),
            head=_head(subject, skin, has_headset),
            arms={hand: (_upper_arm(subject, hand, skin), _forearm(subject, hand, skin)) for hand in HANDS},
            shoulders=Shape.of("shoulders", TRUNK_ID, yoke, subject.shirt, scale=(0.9, 1.0, 1.0), texture=cloth),
            neck=Shape.of("neck", HEAD_ID, tapered_capsule(58.0, 54.0, 110.0), skin),
        )

    def bodies(self, subject: Subject, state: State) -> list[Body]:
        """Return everything of the person at one instant, the hands first."""
        posture = state.posture
        bodies = [self._hand(subject, state, hand) for hand in HANDS]
        for hand in HANDS:
            upper, fore = self.arms[hand]
            side = state.hands[hand].T_world_from_wrist[:3, 0]
            shoulder, elbow, wrist = posture.shoulders_mm[hand], posture.elbows_mm[hand], posture.wrists_mm[hand]
            bodies += [shape.moved(_between(shoulder, elbow, side)) for shape in upper]
            bodies += [shape.moved(_between(elbow, wrist, side)) for shape in fore]
        bodies += [shape.moved(posture.T_world_from_trunk) for shape in self.trunk]
        across = _between(posture.shoulders_mm["left"], posture.shoulders_mm["right"], np.array([0.0, 1.0, 0.0]))
        T_world_from_head = transforms.inverse(state.T_headset_from_world)
        neck = _between(posture.neck_mm - (0.0, 25.0, 0.0), T_world_from_head[:3, 3], np.array([0.0, 0.0, 1.0]))
        bodies += [self.shoulders.moved(across), self.neck.moved(neck)]
        return bodies + [shape.moved(T_world_from_head) for shape in self.head]

    def _hand(self, subject: Subject, state: State, hand: Hand) -> Body:
        mesh = self.hands[hand]
        skin = mesh.skin(state.hands[hand], state.posture.elbows_mm[hand])
        albedo = mesh.albedo if subject.gloves is None else np.tile(np.array(subject.gloves), (len(skin), 1))
        texture = None if subject.gloves is None else Texture("cloth", _darker(subject.gloves), 1.6, 0.35)
        rest = mesh.right_rest_mm.astype(np.float32)
        gloss = 0.3 if subject.gloves is None else 0.1
        skin32, albedo32 = skin.astype(np.float32), albedo.astype(np.float32)
        return Body(f"{hand} hand", HAND_IDS[hand], skin32, mesh.faces, albedo32, gloss, texture=texture, rest_mm=rest)


_UPRIGHT: Final = transforms.rigid(rotation(np.array([-np.pi / 2, 0.0, 0.0])), np.zeros(3))
"""Takes z of a turned solid to y of the trunk."""
_TRUNK: Final = (
    *((0.0, -60.0), (120.0, -60.0), (170.0, -20.0), (172.0, 60.0), (152.0, 190.0), (160.0, 300.0), (178.0, 420.0)),
    *((172.0, 490.0), (140.0, 535.0), (80.0, 560.0), (62.0, 575.0), (0.0, 576.0)),
)
_SKULL: Final = (
    *((0.0, -118.0), (26.0, -114.0), (44.0, -98.0), (60.0, -66.0), (70.0, -25.0), (75.0, 15.0), (75.0, 45.0)),
    *((68.0, 75.0), (52.0, 98.0), (28.0, 112.0), (0.0, 116.0)),
)
_HAIR: Final = (
    *((0.0, -62.0), (66.0, -58.0), (78.0, -30.0), (82.0, 10.0), (82.0, 45.0), (75.0, 80.0), (58.0, 105.0)),
    *((32.0, 120.0), (0.0, 124.0)),
)
_HEAD_DEPTH: Final = 1.14


def _stretch(depth: float, scale: float) -> tuple[float, float, float]:
    return depth * scale, scale, scale


def _head(subject: Subject, skin: Color, has_headset: bool) -> tuple[Shape, ...]:
    """Skull, hair, ears and a mouth; a headset in front of the eyes, or eyes and a nose."""
    hair = transforms.rigid(_HEAD_UP @ rotation(np.array([0.55, 0.0, 0.0])), np.array([0.0, -8.0, -14.0]))
    up = transforms.rigid(_HEAD_UP, np.zeros(3))
    shapes = [
        Shape.of("head", HEAD_ID, Lathe(_SKULL, 28), skin, up, (1.0, _HEAD_DEPTH, 1.0), 0.3),
        Shape.of("hair", HEAD_ID, Lathe(_HAIR, 28), subject.hair, hair, (1.0, 1.08, 1.0), 0.25),
        _blob("mouth", _reddish(skin), (0.0, 66.0, 66.0), (21.0, 6.0, 8.0)),
        *(_blob("ear", skin, (side * 76.0, 10.0, -6.0), (7.0, 28.0, 16.0)) for side in (-1.0, 1.0)),
    ]
    if has_headset:
        return (*shapes, *_headset())
    for side in (-1.0, 1.0):
        shapes.append(_blob("eye", _EYE_WHITE, (side * 31.0, -14.0, 68.0), (14.0, 9.0, 9.0)))
        shapes.append(_blob("iris", _DARK, (side * 31.0, -14.0, 73.0), (6.5, 6.5, 5.5)))
        shapes.append(_blob("brow", subject.hair, (side * 31.0, -33.0, 72.0), (18.0, 4.0, 8.0)))
    return (*shapes, _blob("nose", skin, (0.0, 16.0, 80.0), (13.0, 26.0, 20.0)))


_HEAD_UP: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Takes z of a turned solid to up (-y) of the headset's frame, and its y to ahead."""


def _headset() -> list[Shape]:
    """A visor whose front lies just behind the cameras of `headset`, and a strap."""
    visor = transforms.rigid(np.eye(3), np.array([0.0, 2.0, 64.0]))
    strap = transforms.rigid(_HEAD_UP, np.array([0.0, -6.0, -4.0]))
    return [
        Shape.of("headset", HEADSET_ID, Box((166.0, 100.0, 46.0), 9.0), _VISOR, visor, gloss=0.5),
        Shape.of("strap", HEADSET_ID, cylinder(84.0, 30.0, 3.0, 32), _VISOR, strap, (1.0, 1.1, 1.0)),
    ]


def _blob(name: str, color: Color, center_mm: tuple[float, float, float], half_mm: tuple[float, float, float]) -> Shape:
    ball = tapered_capsule(1.0, 1.0, 1e-3, 16)
    return Shape.of(name, HEAD_ID, ball, color, transforms.rigid(np.eye(3), np.array(center_mm)), half_mm, 0.35)


def _upper_arm(subject: Subject, hand: Hand, skin: Color) -> tuple[Shape, ...]:
    scale, length = subject.scale, subject.upper_arm_mm
    arm = tapered_capsule(46.0 * scale, 38.0 * scale, length, middle_radius_mm=45.0 * scale)
    reach = length * _SLEEVE_END[subject.sleeve]
    sleeve = tapered_capsule(60.0 * scale, 50.0 * scale, reach - 20.0)
    cloth = _cloth(subject)
    return (
        Shape.of(f"{hand} upper arm", ARM_IDS[hand], arm, skin, gloss=0.3),
        Shape.of(f"{hand} sleeve", ARM_IDS[hand], sleeve, subject.shirt, texture=cloth),
    )


def _forearm(subject: Subject, hand: Hand, skin: Color) -> tuple[Shape, ...]:
    """Round at the elbow, flat at the wrist, where it ends inside the hand's skin; sleeve and watch around it."""
    scale, end, girth = subject.scale, subject.forearm_mm, subject.hand_shape.palm_scale
    wrist = 1.0 * float(girth[0])
    ring = ((39.0 * scale, 0.0), (44.0 * scale, 0.25 * end), (38.0 * scale, 0.55 * end), (31.0 * wrist, end - 66.0))
    elbow = ((0.0, -38.0 * scale), (20.0 * scale, -34.0 * scale), (34.0 * scale, -19.0 * scale))
    arm = Lathe((*elbow, *ring, (28.0 * wrist, end - 45.0), (25.0 * wrist, end - 25.0), (0.0, end - 20.0)))
    shapes = [_flattened(Shape.of(f"{hand} forearm", ARM_IDS[hand], arm, skin, gloss=0.3), end)]
    if subject.sleeve == "long":
        cuff = 34.0 * wrist + 5.0
        outline = ((0.0, -48.0 * scale), (46.0 * scale, -20.0), (53.0 * scale, 0.25 * end), (cuff, end - 62.0))
        sleeve = Lathe((*outline, (cuff - 3.0, end - 58.0), (0.0, end - 56.0)))
        shape = Shape.of(f"{hand} cuff", ARM_IDS[hand], sleeve, subject.shirt, texture=_cloth(subject))
        shapes.append(_flattened(shape, end))
    if subject.watch == hand:
        shapes += _watch(hand, end, wrist, subject.sleeve == "long")
    if subject.gloves is not None:
        cuff_solid = Lathe(
            ((0.0, end - 74.0), (35.0 * wrist, end - 74.0), (31.0 * wrist, end - 20.0), (0.0, end - 20.0))
        )
        shapes.append(_flattened(Shape.of(f"{hand} glove", HAND_IDS[hand], cuff_solid, subject.gloves), end))
    return tuple(shapes)


def _watch(hand: Hand, end_mm: float, wrist: float, is_over_sleeve: bool) -> list[Shape]:
    """A strap around the wrist and a dial on its back."""
    z, radius = end_mm - 42.0, 33.5 * wrist
    face = transforms.rigid(rotation(np.array([-np.pi / 2, 0.0, 0.0])), np.array([0.0, 17.5 * wrist, z]))
    strap = transforms.rigid(np.eye(3), np.array([0.0, 0.0, z]))
    return [
        _flattened(Shape.of(f"{hand} strap", ARM_IDS[hand], cylinder(radius, 18.0, 1.5), _DARK, strap), end_mm),
        Shape.of(f"{hand} watch", ARM_IDS[hand], cylinder(17.0, 9.0, 2.0), (0.35, 0.36, 0.38), face, gloss=0.9),
    ]


def _flattened(shape: Shape, end_mm: float) -> Shape:
    """Press a forearm flat towards the wrist, as the hand's skin is: ±28 mm wide, 22 mm down and 15 mm up."""
    vertices = shape.vertices_mm.copy()
    share = np.clip(vertices[:, 2] / end_mm, 0.0, 1.0) ** 2
    vertices[:, 1] = vertices[:, 1] * (1 - 0.34 * share) - 3.5 * share
    return replace(shape, vertices_mm=vertices)


def _between(
    start_mm: Float64[np.ndarray, "3"], end_mm: Float64[np.ndarray, "3"], side: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "4 4"]:
    """The frame at one point whose z points to another and whose x leans to a side."""
    z = end_mm - start_mm
    z = z / np.linalg.norm(z)
    x = side - z * (z @ side)
    x = x / np.linalg.norm(x)
    return transforms.rigid(np.stack([x, np.cross(z, x), z], axis=-1), start_mm)


def _cloth(subject: Subject) -> Texture:
    accent = _darker(subject.shirt)
    if subject.is_striped:
        return Texture("checker", accent, 34.0, 0.45, subject.seed % 1000 + 1)
    return Texture("cloth", accent, 3.0, 0.5, subject.seed % 1000 + 1)


def _darker(color: Color) -> Color:
    return 0.5 * color[0], 0.5 * color[1], 0.5 * color[2]


def _reddish(skin: Color) -> Color:
    return 0.75 * skin[0], 0.42 * skin[1], 0.42 * skin[2]
