"""What lies on the table: parts with a shape, a way to rest, grips and a place in the toy they belong to.

Part frame, mm: z points out of whatever the part is mounted on, so that it is put on along -z; a part that is not a
`lying` one rests with z up. Nouns are Assembly101's where it has one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.grips import Contact, GripKind
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.motion import shifted
from assemblyhands_core.synthetic.solids import Solid

Color = tuple[float, float, float]
"""Linear red, green, blue in 0..1."""


class Piece(NamedTuple):
    """A coloured solid of a part."""

    solid: Solid
    T_part_from_solid: Float64[np.ndarray, "4 4"]
    color: Color


@dataclass(frozen=True, eq=False)
class Grip:
    """Where a part may be gripped.

    Attributes:
        kind: Which fingertips touch and how wide it is.
        T_part_from_grip: One possible grip (axes: see `grips`), mm.
        num_turns: In how many steps around the part's z axis it may be taken as well.
        num_rolls: In how many steps the hand may be rolled around the grip's own z axis.
    """

    kind: GripKind
    T_part_from_grip: Float64[np.ndarray, "4 4"]
    num_turns: int = 1
    num_rolls: int = 1


@dataclass(frozen=True, eq=False)
class Mount:
    """Where a part belongs.

    Attributes:
        parent: Name of the part it is put on.
        T_parent_from_part: When it is all the way in, mm.
        travel_mm: How far it stands out before it is screwed in; 0 for parts that are not screwed.
        num_turns: In how many steps around z it fits.
    """

    parent: str
    T_parent_from_part: Float64[np.ndarray, "4 4"]
    travel_mm: float = 0.0
    num_turns: int = 1


_ABOVE_AXIS_MM: Final = 3.0
"""Where fingertips touch a lying part, so that they keep off the table."""


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid thing.

    Attributes:
        name: Unique in its set.
        noun: What it is called.
        pieces: Its solids.
        height_mm: Of the origin above the table when it rests.
        pick: The grip from the table.
        work: The grip to mount, turn or use it with; the one from the table if None.
        is_lying: Rests with its x axis up (bolts, tools) instead of z.
        mount: Where it belongs, if anywhere.
        gloss: As of `bodies.Body`.
        metallic: As of `bodies.Body`.
        texture: As of `bodies.Body`.
    """

    name: str
    noun: str
    pieces: tuple[Piece, ...]
    height_mm: float
    pick: Grip
    work: Grip | None = None
    is_lying: bool = False
    mount: Mount | None = None
    gloss: float = 0.5
    metallic: float = 0.0
    texture: Texture | None = None

    @property
    def working_grip(self) -> Grip:
        """The grip to mount, turn or use it with."""
        return self.work or self.pick

    def resting(self, x_mm: float, z_mm: float, yaw_rad: float, table_top_mm: float) -> Float64[np.ndarray, "4 4"]:
        """Return `T_world_from_part` on a table (world: +y up)."""
        up = np.array([0.0, 1.0, 0.0])
        ahead = np.array([np.cos(yaw_rad), 0.0, np.sin(yaw_rad)])
        aside = np.cross(up, ahead)
        axes = (up, ahead, aside) if self.is_lying else (ahead, np.cross(up, ahead), up)
        return transforms.rigid(np.stack(axes, axis=-1), np.array([x_mm, table_top_mm + self.height_mm, z_mm]))

    def signed_distance_mm(self, points_mm: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Return the distance of points in the part's frame to its surface, negative inside."""
        distances = [
            p.solid.signed_distance_mm(transforms.apply(transforms.inverse(p.T_part_from_solid), points_mm))
            for p in self.pieces
        ]
        return np.asarray(np.min(distances, axis=0))

    @cached_property
    def radius_mm(self) -> float:
        """Of the ball around the origin that holds the part."""
        return float(np.linalg.norm(self.vertices_mm, axis=-1).max())

    @cached_property
    def vertices_mm(self) -> Float64[np.ndarray, "vertex 3"]:
        """All vertices in the part's frame."""
        return np.concatenate([transforms.apply(p.T_part_from_solid, p.solid.mesh.vertices_mm) for p in self.pieces])

    @cached_property
    def faces(self) -> Int[np.ndarray, "face 3"]:
        """All faces; every piece is closed by itself."""
        counts = [len(p.solid.mesh.vertices_mm) for p in self.pieces]
        firsts = np.cumsum([0, *counts[:-1]])
        return np.concatenate([p.solid.mesh.faces + int(first) for p, first in zip(self.pieces, firsts, strict=True)])

    @cached_property
    def albedo(self) -> Float64[np.ndarray, "vertex 3"]:
        """The colour of each vertex."""
        return np.concatenate(
            [np.tile(np.array(p.color, dtype=np.float64), (len(p.solid.mesh.vertices_mm), 1)) for p in self.pieces]
        )


@dataclass(frozen=True, eq=False)
class PartSet:
    """Everything that lies on the table in one take.

    Attributes:
        toy_id: As in names of recordings.
        toy_name: What it is.
        workpiece: The part that a hand holds while the other works on it.
        parts: By name, parents before what is mounted on them.
        tool: Name of the screwdriver, if there is one.
    """

    toy_id: str
    toy_name: str
    workpiece: str
    parts: Mapping[str, Part]
    tool: str | None = None
    children: Mapping[str, tuple[str, ...]] = field(init=False)

    def __post_init__(self) -> None:
        children: dict[str, tuple[str, ...]] = dict.fromkeys(self.parts, ())
        for name, part in self.parts.items():
            if part.mount:
                children[part.mount.parent] += (name,)
        object.__setattr__(self, "children", children)

    def root(self, name: str) -> str:
        """Return the part at the bottom of the chain that a part is mounted in."""
        mount = self.parts[name].mount
        return self.root(mount.parent) if mount else name

    def T_root_from_part(self, name: str) -> Float64[np.ndarray, "4 4"]:
        """Return where a part sits in the finished toy, mm."""
        mount = self.parts[name].mount
        return self.T_root_from_part(mount.parent) @ mount.T_parent_from_part if mount else np.eye(4)


def piece(solid: Solid, color: Color, at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Piece:
    """Return a coloured solid at a place in its part, not turned."""
    return Piece(solid, shifted(*at_mm), color)


def pointing(
    z: tuple[float, float, float], x: tuple[float, float, float], at_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Float64[np.ndarray, "4 4"]:
    """Return the frame at a place whose z and x axes point along two perpendicular unit vectors."""
    axes = np.stack([np.array(x), np.cross(z, x), np.array(z)], axis=-1)
    return transforms.rigid(axes, np.array(at_mm))


def grip_from_above(contact: Contact, width_mm: float, z_mm: float, num_rolls: int, x_mm: float = 0.0) -> Grip:
    """Return a grip against the part's z axis, thumb and fingers along y (or, where it can be rolled, anywhere)."""
    frame = pointing((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (x_mm, 0.0, z_mm))
    return Grip(GripKind(contact, width_mm), frame, num_rolls=num_rolls)


def grip_lying(contact: Contact, width_mm: float, z_mm: float) -> Grip:
    """Return a grip of a lying part from above, thumb and fingers across its z axis."""
    frame = pointing((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (_ABOVE_AXIS_MM, 0.0, z_mm))
    return Grip(GripKind(contact, width_mm), frame, num_rolls=2)


def grip_around(width_mm: float, z_mm: float) -> Grip:
    """Return a grip of an upright round part from any side, thumb and fingers around its z axis."""
    frame = pointing((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, z_mm))
    return Grip(GripKind("wrap", width_mm), frame, num_turns=24, num_rolls=2)
