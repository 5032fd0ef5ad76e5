"""How bright a point of a surface is: diffuse and glossy reflection of lamps and of the light from everywhere."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.bodies import Scene
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.materials import paint
from assemblyhands_core.synthetic.surfaces import Hits, Surfaces

WHITE = 16384
"""Linear pictures are 16-bit numbers in which a fully lit white surface is this: highlights go up to 4 times more."""

REFERENCE_MM = 1000.0
"""Where a lamp has its stated intensity."""

_DIELECTRIC = np.float32(0.04)  # what all that is no metal mirrors when seen straight on
_AROUND, _TOWARDS_LAMPS = np.float32(0.72), np.float32(0.39)  # light from everywhere: mean, and more from the lamps
_MIRRORED = np.float32(0.2)  # the room seen in a mirror that does not show the lamps' side
_ZERO, _ONE, _EIGHT, _TINY = np.float32(0), np.float32(1), np.float32(8), np.float32(1e-6)
_REFERENCE_SQUARED = np.float32(REFERENCE_MM**2)


@dataclass(frozen=True, eq=False)
class Shaded:
    """Points of surfaces as a camera sees them, before shadows.

    Attributes:
        positions_mm: A little off the surface.
        terms: Linear light that each sends to the camera: from everywhere, then from each of the scene's lights.
    """

    positions_mm: Float32[np.ndarray, "point 3"]
    terms: Float32[np.ndarray, "point term 3"]

    def facing(self, light: int) -> Int32[np.ndarray, " facing"]:
        """Return which points face one of the lights."""
        return _facing(self.terms, light)


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
    return Shaded(points.positions_mm, terms)


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

    Lambert's law for the diffuse part. The glossy part is a lobe around the half-way vector, normalised, in the form
    of Schlick ("An inexpensive BRDF model", 1994), which needs no power, with his Fresnel term for the surroundings.
    These are brighter on the side of the lamps.
    """
    terms = np.zeros((len(positions), 1 + len(lamps), 3), np.float32)
    exponents = (2.8 * np.exp(5.5 * gloss)).astype(np.float32)
    peaks = gloss * (exponents + _EIGHT) / _EIGHT
    share = _ONE / np.float32(max(len(lamps), 1))
    sided = _ONE if len(lamps) else _ZERO  # without lamps light comes from all sides alike
    middle_x, middle_y, middle_z = lamps[:, 0].sum() * share, lamps[:, 1].sum() * share, lamps[:, 2].sum() * share
    for i in range(len(positions)):
        shine, metal = gloss[bodies[i]], metallic[bodies[i]]
        exponent, peak, matt = exponents[bodies[i]], peaks[bodies[i]], _ONE - metal
        px, py, pz = positions[i, 0], positions[i, 1], positions[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        rx, ry, rz = rays[i, 0], rays[i, 1], rays[i, 2]
        ux, uy, uz = middle_x - px, middle_y - py, middle_z - pz
        scale = sided / np.sqrt(ux * ux + uy * uy + uz * uz + _TINY)
        facing = -(nx * rx + ny * ry + nz * rz)
        lift = (nx * ux + ny * uy + nz * uz) * scale
        mirror = max((rx * ux + ry * uy + rz * uz) * scale + (facing + facing) * lift, _ZERO)
        grazing = _ONE - min(max(facing, _ZERO), _ONE)
        grazing *= grazing * grazing * grazing * grazing * shine * shine
        around = _AROUND * matt * (_ONE + _TOWARDS_LAMPS * lift)
        reflected = (_MIRRORED + mirror * mirror) * (shine * shine + metal * (_ONE - shine * shine))
        for k in range(3):
            straight = _DIELECTRIC + metal * (albedo[i, k] - _DIELECTRIC)
            fresnel = straight + (_ONE - straight) * grazing
            terms[i, 0, k] = ambient[k] * (albedo[i, k] * around + fresnel * reflected)
        for lamp in range(len(lamps)):
            lx, ly, lz = lamps[lamp, 0] - px, lamps[lamp, 1] - py, lamps[lamp, 2] - pz
            incident = lx * nx + ly * ny + lz * nz
            if incident <= _ZERO:
                continue
            scale = _ONE / np.sqrt(lx * lx + ly * ly + lz * lz)
            incident *= scale
            opposed = _ONE - (lx * rx + ly * ry + lz * rz) * scale  # half the square of the half-way vector
            cosine = max((incident + facing) / np.sqrt(opposed + opposed + _TINY), _ZERO)
            lobe = peak * cosine / (exponent - exponent * cosine + cosine)
            falloff = incident * (_REFERENCE_SQUARED * scale * scale)
            for k in range(3):
                straight = _DIELECTRIC + metal * (albedo[i, k] - _DIELECTRIC)
                terms[i, 1 + lamp, k] = lamps[lamp, 3 + k] * falloff * (albedo[i, k] * matt + straight * lobe)
    return terms


@compiled
def collect(
    pixels: Int32[np.ndarray, " point"],
    terms: Float32[np.ndarray, "point term 3"],
    shares: Float32[np.ndarray, "light point"],
    linear: UInt16[np.ndarray, "height width 3"],
    direct: UInt16[np.ndarray, "kept height width 3"],
) -> None:
    """Put the light that points send into a linear picture.

    Args:
        pixels: Flat indices.
        terms: From `shade`.
        shares: Of each light that reaches the points.
        linear: See `WHITE`.
        direct: Each light's part of it, for as many as there is room.
    """
    width = linear.shape[1]
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        for k in range(3):
            light = terms[i, 0, k]
            for lamp in range(len(shares)):
                part = terms[i, 1 + lamp, k] * shares[lamp, i]
                light += part
                if lamp < len(direct):
                    direct[lamp, row, column, k] = min(int(part * WHITE + 0.5), 65535)
            linear[row, column, k] = min(int(light * WHITE + 0.5), 65535)


@compiled
def _facing(terms: Float32[np.ndarray, "point term 3"], light: int) -> Int32[np.ndarray, " facing"]:
    facing = np.empty(len(terms), np.int32)
    count = 0
    for i in range(len(terms)):
        if terms[i, 1 + light, 0] + terms[i, 1 + light, 1] + terms[i, 1 + light, 2] > 0:
            facing[count] = i
            count += 1
    return facing[:count]
