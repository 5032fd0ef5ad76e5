"""How bright a point of a surface is: diffuse and glossy reflection of lamps and of the light from everywhere."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.bodies import Scene
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.materials import paint
from assemblyhands_core.synthetic.surfaces import Hits, Surfaces

REFERENCE_MM = 1000.0
"""Where a lamp has its stated intensity."""


@dataclass(frozen=True, eq=False)
class Shaded:
    """Points of surfaces as a camera sees them, before shadows.

    Attributes:
        positions_mm: A little off the surface.
        normals: Unit, towards the camera.
        terms: Linear light that each sends to the camera: from everywhere, then from each of the scene's lights.
    """

    positions_mm: Float32[np.ndarray, "point 3"]
    normals: Float32[np.ndarray, "point 3"]
    terms: Float32[np.ndarray, "point term 3"]

    @staticmethod
    def joined(parts: "Sequence[Shaded]") -> "Shaded":
        """Join lists of points."""
        fields = ([getattr(part, name) for part in parts] for name in ("positions_mm", "normals", "terms"))
        return Shaded(*map(np.concatenate, fields))


def shade(scene: Scene, surfaces: Surfaces, camera: Camera, rays: Float32[np.ndarray, "point 3"], hits: Hits) -> Shaded:
    """Return how bright the points are where a camera's rays meet surfaces; every ray has to meet one."""
    points = surfaces.points(camera.center_world_mm.astype(np.float32), rays, hits)
    footprint_mm = hits.distances_mm * np.float32(pixel_rad(camera))
    paint(points.albedo, points.places_mm, footprint_mm, points.bodies, surfaces.textures)
    rows = [(*light.position_mm, *light.intensity) for light in scene.lights]
    lamps = np.array(rows, dtype=np.float32).reshape(-1, 6)
    shine = points.bodies, surfaces.gloss, surfaces.metallic
    ambient = np.array(scene.ambient, dtype=np.float32)
    terms = _light_terms(points.positions_mm, points.normals, rays, points.albedo, *shine, lamps, ambient)
    return Shaded(points.positions_mm, points.normals, terms)


def pixel_rad(camera: Camera) -> float:
    """Return the angle between the rays of neighbouring pixels in the middle of the picture."""
    return 1 / float(np.sqrt(camera.fx_px * camera.fy_px))


@compiled
def _light_terms(
    positions: Float32[np.ndarray, "point 3"],
    normals: Float32[np.ndarray, "point 3"],
    rays: Float32[np.ndarray, "point 3"],
    albedo: Float32[np.ndarray, "point 3"],
    bodies: Int32[np.ndarray, " point"],
    gloss: Float32[np.ndarray, " body"],
    metallic: Float32[np.ndarray, " body"],
    lamps: Float32[np.ndarray, "lamp 6"],
    ambient: Float32[np.ndarray, "3"],
) -> Float32[np.ndarray, "point term 3"]:
    """Return the light that points send to the camera: from everywhere first, then from each lamp if not blocked.

    Lambert's law for the diffuse part; Blinn and Phong's lobe, normalised, with Schlick's Fresnel term for gloss. The
    surroundings are brighter on the side of the lamps.
    """
    terms = np.zeros((len(positions), 1 + len(lamps), 3), np.float32)
    one = np.float32(1)
    up = np.empty(3, np.float32)
    for i in range(len(positions)):
        shine, metal = gloss[bodies[i]], metallic[bodies[i]]
        normal, ray = normals[i], rays[i]
        length = np.float32(1e-9)
        for k in range(3):
            up[k] = np.float32(0)
            for lamp in range(len(lamps)):
                up[k] += lamps[lamp, k] - positions[i, k]
            length += up[k] * up[k]
        length = np.sqrt(length)
        facing = -(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2])
        lift, mirror = np.float32(0), np.float32(0)
        for k in range(3):
            lift += normal[k] * up[k] / length
            mirror += (ray[k] + 2 * facing * normal[k]) * up[k] / length
        facing = min(max(facing, np.float32(0.02)), one)
        grazing = (one - facing) ** 2
        grazing = grazing * grazing * (one - facing)
        smooth = shine * shine
        seen = np.float32(0.2) + np.float32(1.1) * max(mirror, np.float32(0)) ** 2  # the room in the mirror
        around = np.float32(0.72) + np.float32(0.28) * lift
        for k in range(3):
            straight = np.float32(0.04) + metal * (albedo[i, k] - np.float32(0.04))
            fresnel = straight + (one - straight) * grazing * smooth
            diffuse = albedo[i, k] * (one - metal)
            terms[i, 0, k] = ambient[k] * (diffuse * around + fresnel * seen * (smooth + metal * (one - smooth)))
        exponent = np.float32(2) ** (np.float32(1.5) + 8 * shine)
        for lamp in range(len(lamps)):
            x = lamps[lamp, 0] - positions[i, 0]
            y = lamps[lamp, 1] - positions[i, 1]
            z = lamps[lamp, 2] - positions[i, 2]
            squared = x * x + y * y + z * z
            distance = np.sqrt(squared)
            x, y, z = x / distance, y / distance, z / distance
            incident = x * normal[0] + y * normal[1] + z * normal[2]
            if incident <= 0:
                continue
            hx, hy, hz = x - ray[0], y - ray[1], z - ray[2]
            half = np.sqrt(hx * hx + hy * hy + hz * hz) + np.float32(1e-9)
            cosine = max((hx * normal[0] + hy * normal[1] + hz * normal[2]) / half, np.float32(0))
            lobe = cosine**exponent * (exponent + 8) / 8 * shine
            falloff = incident * np.float32(REFERENCE_MM**2) / squared
            for k in range(3):
                straight = np.float32(0.04) + metal * (albedo[i, k] - np.float32(0.04))
                diffuse = albedo[i, k] * (one - metal)
                terms[i, 1 + lamp, k] = lamps[lamp, 3 + k] * falloff * (diffuse + straight * lobe)
    return terms
