"""Simple closed solids: a triangle mesh to draw and an exact signed distance to touch.

Convention: a solid lives in its own frame in mm, turned solids (`Lathe`) about the z axis; faces wind outwards.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int


class Mesh(NamedTuple):
    """A closed triangle mesh whose faces wind counter-clockwise seen from outside."""

    vertices_mm: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]


@dataclass(frozen=True, eq=False)
class Box:
    """A box about the origin with bevelled edges.

    Attributes:
        size_mm: Full extent along x, y, z.
        bevel_mm: Width of the bevel; the signed distance ignores it.
    """

    size_mm: tuple[float, float, float]
    bevel_mm: float = 2.0

    @cached_property
    def mesh(self) -> Mesh:
        """The surface: 6 faces, 12 bevels, 8 corners."""
        half = np.array(self.size_mm) / 2
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
        # Vertex 3 c + a lies at corner c and keeps its full extent along axis a only.
        reach = half - self.bevel_mm * (1 - np.eye(3))
        vertices = (signs[:, None, :] * reach).reshape(-1, 3)
        polygons = [*_box_faces(), *_box_bevels(), *[tuple(3 * corner + a for a in range(3)) for corner in range(8)]]
        faces = np.array([(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)], dtype=np.int32)
        return Mesh(vertices, wound_outwards(vertices, faces))

    def signed_distance_mm(self, points_mm: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Return the distance of points to the unbevelled box, negative inside."""
        excess = np.abs(points_mm) - np.array(self.size_mm) / 2
        outside = np.linalg.norm(np.maximum(excess, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(excess.max(axis=-1), 0.0))


@dataclass(frozen=True, eq=False)
class Lathe:
    """A solid turned about the z axis.

    Attributes:
        profile_mm: Outline from the lower to the upper pole as (radius, z) pairs; it begins and ends on the axis.
        num_sides: Number of sides around the axis.
    """

    profile_mm: tuple[tuple[float, float], ...]
    num_sides: int = 24

    @cached_property
    def mesh(self) -> Mesh:
        """The surface: a ring of vertices per point of the outline, one vertex per pole."""
        outline, n = np.array(self.profile_mm), self.num_sides
        angle = np.arange(n) * 2 * np.pi / n
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=-1)
        rings = outline[1:-1, None, :1] * circle + outline[1:-1, None, 1:] * np.array([0.0, 0.0, 1.0])
        poles = np.array([[0.0, 0.0, outline[0, 1]], [0.0, 0.0, outline[-1, 1]]])
        here, beside = np.arange(n), (np.arange(n) + 1) % n
        faces = [np.stack([np.full(n, -2), beside, here], axis=-1)]
        for ring in range(len(rings) - 1):
            a, b, c, d = ring * n + here, ring * n + beside, (ring + 1) * n + beside, (ring + 1) * n + here
            faces += [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
        last = (len(rings) - 1) * n
        faces.append(np.stack([np.full(n, -1), last + here, last + beside], axis=-1))
        vertices = np.concatenate([rings.reshape(-1, 3), poles])
        return Mesh(vertices, (np.concatenate(faces) % len(vertices)).astype(np.int32))

    def signed_distance_mm(self, points_mm: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Return the distance of points to the turned outline, negative inside."""
        flat = np.stack([np.hypot(points_mm[..., 0], points_mm[..., 1]), points_mm[..., 2]], axis=-1)
        start, end = np.array(self.profile_mm[:-1]), np.array(self.profile_mm[1:])
        along = end - start
        offset = flat[..., None, :] - start
        share = np.clip((offset * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12), 0.0, 1.0)
        distance = np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=-1)
        return np.asarray(np.where(_is_inside(flat, start, end), -distance, distance))


Solid: TypeAlias = Box | Lathe
"""What can be drawn and touched."""


def cylinder(radius_mm: float, length_mm: float, bevel_mm: float = 1.0, num_sides: int = 24) -> Lathe:
    """Return a cylinder about the origin with its axis along z."""
    z, inner = length_mm / 2, radius_mm - bevel_mm
    outline = ((0.0, -z), (inner, -z), (radius_mm, -z + bevel_mm), (radius_mm, z - bevel_mm), (inner, z), (0.0, z))
    return Lathe(outline, num_sides)


def tapered_capsule(
    start_radius_mm: float, end_radius_mm: float, length_mm: float, num_sides: int = 20, middle_radius_mm: float = 0.0
) -> Lathe:
    """Return a limb along z from the origin to `length_mm`, rounded at both ends.

    Args:
        start_radius_mm: Radius at z = 0.
        end_radius_mm: Radius at z = length.
        length_mm: Between the centres of the rounded ends.
        num_sides: Number of sides around the axis.
        middle_radius_mm: Radius half way, for a muscle; the mean of both ends when 0.
    """
    middle = middle_radius_mm or (start_radius_mm + end_radius_mm) / 2
    dip = np.sin(np.linspace(0.0, np.pi / 2, 5))
    lower = [(start_radius_mm * d, -start_radius_mm * float(np.sqrt(1 - d * d))) for d in dip]
    upper = [
        (end_radius_mm * d, length_mm + end_radius_mm * float(np.sqrt(max(0.0, 1 - d * d)))) for d in reversed(dip)
    ]
    share = np.linspace(0.0, 1.0, 7)[1:-1]
    radii = (1 - share) * start_radius_mm + share * end_radius_mm
    radii += (middle - (start_radius_mm + end_radius_mm) / 2) * np.sin(np.pi * share) ** 2
    body = [(float(r), float(s * length_mm)) for r, s in zip(radii, share, strict=True)]
    return Lathe(tuple((float(r), float(z)) for r, z in (*lower, *body, *upper)), num_sides)


def wound_outwards(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Int[np.ndarray, "face 3"]:
    """Turn the faces of a convex mesh around the origin so that they wind outwards."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inwards = (np.cross(b - a, c - a) * (a + b + c)).sum(-1) < 0
    return np.where(inwards[:, None], faces[:, ::-1], faces)


def _box_faces() -> list[tuple[int, ...]]:
    """The 6 inset faces as rings of vertices; corner c has bits x (4), y (2), z (1)."""
    rings = []
    for axis, bit in enumerate((4, 2, 1)):
        others = [b for b in (4, 2, 1) if b != bit]
        ring = (0, others[0], others[0] | others[1], others[1])
        rings += [tuple(3 * (corner | side) + axis for corner in ring) for side in (0, bit)]
    return rings


def _box_bevels() -> list[tuple[int, ...]]:
    """The 12 bevels: along each axis, between the two faces that meet at its edges."""
    bevels: list[tuple[int, ...]] = []
    for axis, bit in enumerate((4, 2, 1)):
        one, other = (a for a in range(3) if a != axis)
        for corner in (c for c in range(8) if not c & bit):
            far = corner | bit
            bevels.append((3 * corner + one, 3 * far + one, 3 * far + other, 3 * corner + other))
    return bevels


def _is_inside(
    flat: Float[np.ndarray, "*batch 2"], start: Float[np.ndarray, "edge 2"], end: Float[np.ndarray, "edge 2"]
) -> Bool[np.ndarray, "*batch"]:
    """Count the crossings of a ray along +radius with the outline, whose last side is the axis itself."""
    z = flat[..., None, 1]
    crosses = (start[:, 1] > z) != (end[:, 1] > z)
    rise = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    radius = start[:, 0] + (z - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return np.asarray((crosses & (radius > flat[..., None, 0])).sum(-1) % 2 == 1)
