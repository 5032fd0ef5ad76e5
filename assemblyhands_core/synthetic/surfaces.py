"""The triangles of many bodies as one mesh: what a ray meets first, and what lies there."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64, UInt8

from assemblyhands_core.synthetic.compiled import compiled

MISS = -1
"""The face of a ray that meets nothing."""

FAR_MM = np.float32(1e6)
"""The distance of a ray that meets nothing."""

_COS_CREASE = float(np.cos(np.deg2rad(40.0)))
_LIFT_MM = 0.05  # off the surface, for rays that leave it: well above float32 rounding at some metres


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet a mesh first.

    Attributes:
        faces: `MISS` where they meet nothing.
        weights: Barycentric weights of the second and third vertex.
        distances_mm: Along the ray; `FAR_MM` where they meet nothing.
    """

    faces: Int32[np.ndarray, " ray"]
    weights: Float32[np.ndarray, "ray 2"]
    distances_mm: Float32[np.ndarray, " ray"]

    @staticmethod
    def nothing(count: int) -> "Hits":
        """Return rays that meet nothing."""
        return Hits(np.full(count, MISS, np.int32), np.zeros((count, 2), np.float32), np.full(count, FAR_MM))

    def put(self, rays: Int32[np.ndarray, " some"], hits: "Hits") -> None:
        """Note what some of the rays, by index, meet."""
        _put(rays, hits.faces, hits.weights, hits.distances_mm, self.faces, self.weights, self.distances_mm)

    def select(self, rays: Int64[np.ndarray, " some"]) -> "Hits":
        """Return some of the rays, by index."""
        return Hits(self.faces[rays], self.weights[rays], self.distances_mm[rays])


@dataclass(frozen=True, eq=False)
class Points:
    """Points of surfaces, as shading needs them.

    Attributes:
        positions_mm: A little off the surface, and above the flat face where the smooth surface would be, so that
            no shadow of a facet shows (Hanika, "Hacking the shadow terminator", 2021).
        normals: Unit, interpolated, turned towards the camera.
        albedo: Linear RGB without texture.
        places_mm: In the frame of the body, for textures.
        bodies: Index in the list of bodies.
    """

    positions_mm: Float32[np.ndarray, "point 3"]
    normals: Float32[np.ndarray, "point 3"]
    albedo: Float32[np.ndarray, "point 3"]
    places_mm: Float32[np.ndarray, "point 3"]
    bodies: Int32[np.ndarray, " point"]


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Bodies merged into one mesh that rays can be cast at.

    Attributes:
        vertices_mm: In the world.
        faces: Vertices of all bodies.
        albedo: Of vertices.
        rest_mm: Of vertices, in the frame of their body.
        body_of_face: Index into the next four.
        object_ids: For the id mask.
        gloss: See `Body`.
        metallic: See `Body`.
        textures: See `paint`.
        corner_normals: Unit; of a face's three corners, smooth over edges below 40°.
        tree: Embree's bounding volume hierarchy, None without faces.
    """

    vertices_mm: Float32[np.ndarray, "vertex 3"]
    faces: Int32[np.ndarray, "face 3"]
    albedo: Float32[np.ndarray, "vertex 3"]
    rest_mm: Float32[np.ndarray, "vertex 3"]
    body_of_face: Int32[np.ndarray, " face"]
    object_ids: UInt8[np.ndarray, " body"]
    gloss: Float32[np.ndarray, " body"]
    metallic: Float32[np.ndarray, " body"]
    textures: Float32[np.ndarray, "body 9"]
    corner_normals: Float32[np.ndarray, "face 3 3"] = field(init=False)
    tree: Any = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "corner_normals", _corner_normals(self.vertices_mm, self.faces, _COS_CREASE))
        object.__setattr__(self, "tree", _tree(self.vertices_mm, self.faces))

    def first_hits(self, origin_mm: Float32[np.ndarray, "3"], rays: Float32[np.ndarray, "ray 3"]) -> Hits:
        """Return what unit rays from one point meet first."""
        if self.tree is None or not len(rays):
            return Hits.nothing(len(rays))
        found = self.tree.run(_repeated(origin_mm, len(rays)), rays, output=1)
        distances = np.minimum(found["tfar"], FAR_MM)
        return Hits(found["primID"], np.stack((found["u"], found["v"]), axis=-1), distances)

    def blocked(
        self, origins_mm: Float32[np.ndarray, "ray 3"], segments_mm: Float32[np.ndarray, "ray 3"]
    ) -> Bool[np.ndarray, " ray"]:
        """Tell which segments, given by their start and their extent, meet anything."""
        if self.tree is None or not len(segments_mm):
            return np.zeros(len(segments_mm), dtype=bool)
        return np.asarray(self.tree.run(origins_mm, segments_mm, dists=1.0, query="OCCLUDED") != MISS)

    def points(self, origin_mm: Float32[np.ndarray, "3"], rays: Float32[np.ndarray, "ray 3"], hits: Hits) -> Points:
        """Return the surface where rays from one point hit it; every ray has to hit."""
        mesh = self.vertices_mm, self.faces, self.corner_normals, self.albedo, self.rest_mm
        positions, normals, albedo, places = _interpolate(*mesh, origin_mm, rays, hits.faces, hits.weights)
        return Points(positions, normals, albedo, places, self.body_of_face[hits.faces])

    def ids(self, faces: Int32[np.ndarray, " ray"]) -> UInt8[np.ndarray, " ray"]:
        """Return the object ids of faces that were hit."""
        return np.asarray(self.object_ids[self.body_of_face[faces]])


def _repeated(origin: Float32[np.ndarray, "3"], count: int) -> Float32[np.ndarray, "ray 3"]:
    return np.lib.stride_tricks.as_strided(np.ascontiguousarray(origin), (count, 3), (0, origin.itemsize))


def _tree(vertices: Float32[np.ndarray, "vertex 3"], faces: Int32[np.ndarray, "face 3"]) -> Any:
    """Return Embree's bounding volume hierarchy, None for nothing."""
    if not len(faces):
        return None
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    tree = rtcore_scene.EmbreeScene(_device())
    TriangleMesh(scene=tree, vertices=vertices, indices=faces)
    return tree


@lru_cache(1)
def _device() -> Any:
    from embreex.rtcore import EmbreeDevice

    return EmbreeDevice()


@compiled
def _put(
    rays: Int32[np.ndarray, " some"],
    faces: Int32[np.ndarray, " some"],
    weights: Float32[np.ndarray, "some 2"],
    distances: Float32[np.ndarray, " some"],
    all_faces: Int32[np.ndarray, " ray"],
    all_weights: Float32[np.ndarray, "ray 2"],
    all_distances: Float32[np.ndarray, " ray"],
) -> None:
    for i in range(len(rays)):
        ray = rays[i]
        all_faces[ray], all_distances[ray] = faces[i], distances[i]
        all_weights[ray, 0], all_weights[ray, 1] = weights[i, 0], weights[i, 1]


@compiled
def _corner_normals(
    vertices: Float32[np.ndarray, "vertex 3"], faces: Int32[np.ndarray, "face 3"], cos_crease: float
) -> Float32[np.ndarray, "face 3 3"]:
    """Return for each corner the mean of the normals around it, weighted by area, that differ less than the crease."""
    weighted, unit = np.empty((len(faces), 3), np.float32), np.empty((len(faces), 3), np.float32)
    first, around = np.zeros(len(vertices) + 1, np.int32), np.empty(3 * len(faces), np.int32)
    for face in range(len(faces)):
        a, b, c = vertices[faces[face, 0]], vertices[faces[face, 1]], vertices[faces[face, 2]]
        for axis in range(3):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            weighted[face, axis] = (b[p] - a[p]) * (c[q] - a[q]) - (b[q] - a[q]) * (c[p] - a[p])
            first[faces[face, axis] + 1] += 1
        length = np.sqrt(weighted[face, 0] ** 2 + weighted[face, 1] ** 2 + weighted[face, 2] ** 2)
        unit[face] = weighted[face] / max(length, np.float32(1e-20))
    for vertex in range(len(vertices)):
        first[vertex + 1] += first[vertex]
    filled = first[:-1].copy()
    for face in range(len(faces)):
        for corner in range(3):
            around[filled[faces[face, corner]]] = face
            filled[faces[face, corner]] += 1
    normals = np.empty((len(faces), 3, 3), np.float32)
    for face in range(len(faces)):
        for corner in range(3):
            x, y, z = np.float32(0), np.float32(0), np.float32(0)
            for entry in range(first[faces[face, corner]], first[faces[face, corner] + 1]):
                other = around[entry]
                cos = unit[other, 0] * unit[face, 0] + unit[other, 1] * unit[face, 1] + unit[other, 2] * unit[face, 2]
                if cos >= cos_crease or other == face:
                    x, y, z = x + weighted[other, 0], y + weighted[other, 1], z + weighted[other, 2]
            length = max(np.sqrt(x * x + y * y + z * z), np.float32(1e-20))
            normals[face, corner, 0], normals[face, corner, 1], normals[face, corner, 2] = (
                x / length,
                y / length,
                z / length,
            )
    return normals


@compiled
def _interpolate(
    vertices: Float32[np.ndarray, "vertex 3"],
    faces: Int32[np.ndarray, "face 3"],
    corner_normals: Float32[np.ndarray, "face 3 3"],
    albedo: Float32[np.ndarray, "vertex 3"],
    rest: Float32[np.ndarray, "vertex 3"],
    origin: Float32[np.ndarray, "3"],
    rays: Float32[np.ndarray, "ray 3"],
    hit_faces: Int32[np.ndarray, " ray"],
    weights: Float32[np.ndarray, "ray 2"],
) -> tuple[
    Float32[np.ndarray, "ray 3"],
    Float32[np.ndarray, "ray 3"],
    Float32[np.ndarray, "ray 3"],
    Float32[np.ndarray, "ray 3"],
]:
    """Return positions, normals, albedo and rest positions."""
    count = len(rays)
    positions, normals = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    colors, places = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    for i in range(count):
        face = hit_faces[i]
        p, q, r = faces[face, 0], faces[face, 1], faces[face, 2]
        v, w = weights[i, 0], weights[i, 1]
        u = np.float32(1) - v - w
        for k in range(3):
            colors[i, k] = u * albedo[p, k] + v * albedo[q, k] + w * albedo[r, k]
            places[i, k] = u * rest[p, k] + v * rest[q, k] + w * rest[r, k]
        ax, ay, az = vertices[p, 0], vertices[p, 1], vertices[p, 2]
        bx, by, bz = vertices[q, 0] - ax, vertices[q, 1] - ay, vertices[q, 2] - az
        cx, cy, cz = vertices[r, 0] - ax, vertices[r, 1] - ay, vertices[r, 2] - az
        volume = rays[i, 0] * (by * cz - bz * cy) + rays[i, 1] * (bz * cx - bx * cz) + rays[i, 2] * (bx * cy - by * cx)
        side = np.float32(-1) if volume > 0 else np.float32(1)  # faces are seen from both sides
        x, y, z = v * bx + w * cx, v * by + w * cy, v * bz + w * cz  # from the first corner
        nx, ny, nz = np.float32(0), np.float32(0), np.float32(0)
        rise_x, rise_y, rise_z = np.float32(0), np.float32(0), np.float32(0)
        for corner in range(3):
            weight = u if corner == 0 else (v if corner == 1 else w)
            mx, my, mz = (
                corner_normals[face, corner, 0],
                corner_normals[face, corner, 1],
                corner_normals[face, corner, 2],
            )
            nx, ny, nz = nx + weight * mx, ny + weight * my, nz + weight * mz
            fx = x if corner == 0 else (x - bx if corner == 1 else x - cx)
            fy = y if corner == 0 else (y - by if corner == 1 else y - cy)
            fz = z if corner == 0 else (z - bz if corner == 1 else z - cz)
            below = weight * min((fx * mx + fy * my + fz * mz) * side, np.float32(0)) * side
            rise_x, rise_y, rise_z = rise_x - below * mx, rise_y - below * my, rise_z - below * mz
        length = side / max(np.sqrt(nx * nx + ny * ny + nz * nz), np.float32(1e-20))
        normals[i, 0], normals[i, 1], normals[i, 2] = nx * length, ny * length, nz * length
        lift = np.float32(_LIFT_MM) * length
        positions[i, 0] = ax + x + rise_x + lift * nx
        positions[i, 1] = ay + y + rise_y + lift * ny
        positions[i, 2] = az + z + rise_z + lift * nz
    return positions, normals, colors, places
