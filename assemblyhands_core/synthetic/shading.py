"""How bright a point of a surface is: diffuse and glossy reflection of lamps and of the light from everywhere."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt16

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
_PORTION = 8192  # points taken through all steps at a time, so that what lies between them stays in the cache
_BATCH = 64  # points shaded at a time
_ROWS = 19  # numbers for each: position, normal, ray, albedo, gloss, metal, exponent, light sent, facing
_REFERENCE_SQUARED = np.float32(REFERENCE_MM**2)


@dataclass(frozen=True, eq=False)
class Shaded:
    """Points of surfaces as a camera sees them, before shadows.

    Attributes:
        positions_mm: A little off the surface.
        terms: Linear light that each sends to the camera: from everywhere and from the lights that throw no shadows,
            then from each of those that do.
        is_facing: Which points each of these can reach, if nothing else blocks it.
    """

    positions_mm: Float32[np.ndarray, "point 3"]
    terms: Float32[np.ndarray, "point term 3"]
    is_facing: Bool[np.ndarray, "light point"]


def shade(scene: Scene, surfaces: Surfaces, camera: Camera, rays: Float32[np.ndarray, "point 3"], hits: Hits) -> Shaded:
    """Return how bright the points are where a camera's rays meet surfaces; every ray has to meet one."""
    center_mm, angle = camera.center_world_mm.astype(np.float32), np.float32(pixel_rad(camera))
    lights = sorted(scene.lights, key=lambda light: not light.casts_shadow)  # those that throw shadows first
    rows = [(*light.position_mm, *light.intensity) for light in lights]
    lamps, ambient = np.array(rows, np.float32).reshape(-1, 6), np.array(scene.ambient, np.float32)
    positions = np.empty((len(rays), 3), np.float32)
    terms = np.empty((len(rays), 1 + len(scene.shading_lights), 3), np.float32)
    is_facing = np.empty((len(scene.shading_lights), len(rays)), np.bool_)
    for start in range(0, len(rays), _PORTION):
        part = slice(start, start + _PORTION)
        some = Hits(hits.faces[part], hits.weights[part], hits.distances_mm[part])
        points = surfaces.points(center_mm, rays[part], some)
        paint(points.albedo, points.places_mm, some.distances_mm * angle, points.bodies, surfaces.textures)
        shine = points.bodies, surfaces.gloss, surfaces.metallic
        seen = points.positions_mm, points.normals, rays[part], points.albedo
        _light_terms(*seen, *shine, lamps, ambient, terms[part], is_facing, start)
        positions[part] = points.positions_mm
    return Shaded(positions, terms, is_facing)


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
    terms: Float32[np.ndarray, "point term 3"],
    is_facing: Bool[np.ndarray, "lamp any_point"],
    first: int,
) -> None:
    """Find the light that points send to the camera, and which lamps can reach them.

    The points' terms and, from the first point on, which lamps they face are written. What comes from lamps beyond
    those that have a term of their own is added to the light from everywhere.

    Points are taken in batches whose numbers lie side by side in one small array, which the compiler turns into
    instructions on many points at once.
    """
    batch = np.zeros(_ROWS * _BATCH, np.float32)
    exponents = (2.8 * np.exp(5.5 * gloss)).astype(np.float32)
    middle = np.zeros(3, np.float32)
    for lamp in range(len(lamps)):
        middle += lamps[lamp, :3] / np.float32(len(lamps))
    sided = _ONE if len(lamps) else _ZERO  # without lamps light comes from all sides alike
    for start in range(0, len(positions), _BATCH):
        count = min(_BATCH, len(positions) - start)
        for j in range(count):
            i = start + j
            for k in range(3):
                batch[j + k * _BATCH], batch[j + (3 + k) * _BATCH] = positions[i, k], normals[i, k]
                batch[j + (6 + k) * _BATCH], batch[j + (9 + k) * _BATCH] = rays[i, k], albedo[i, k]
            batch[j + 12 * _BATCH], batch[j + 13 * _BATCH] = gloss[bodies[i]], metallic[bodies[i]]
            batch[j + 14 * _BATCH] = exponents[bodies[i]]
        _light_from_everywhere(batch, middle, sided, ambient)
        _unload(batch, terms, start, count, 0)
        for lamp in range(len(lamps)):
            _light_from(batch, lamps[lamp])
            if lamp >= len(is_facing):
                _unload_more(batch, terms, start, count)
                continue
            _unload(batch, terms, start, count, 1 + lamp)
            for j in range(count):
                is_facing[lamp, first + start + j] = batch[j + 18 * _BATCH] > _ZERO


@compiled
def _unload(
    batch: Float32[np.ndarray, " number"],
    terms: Float32[np.ndarray, "point term 3"],
    start: int,
    count: int,
    term: int,
) -> None:
    for j in range(count):
        for k in range(3):
            terms[start + j, term, k] = batch[j + (15 + k) * _BATCH]


@compiled
def _unload_more(
    batch: Float32[np.ndarray, " number"], terms: Float32[np.ndarray, "point term 3"], start: int, count: int
) -> None:
    for j in range(count):
        for k in range(3):
            terms[start + j, 0, k] += batch[j + (15 + k) * _BATCH]


@compiled
def _light_from_everywhere(
    b: Float32[np.ndarray, " number"],
    middle: Float32[np.ndarray, "3"],
    sided: np.float32,
    ambient: Float32[np.ndarray, "3"],
) -> None:
    """Put into rows 15 to 17 what points send of the light from everywhere, brighter on the side of the lamps.

    The mirrored part has the Fresnel term of Schlick ("An inexpensive BRDF model", 1994).
    """
    middle_x, middle_y, middle_z = middle[0], middle[1], middle[2]
    red, green, blue = ambient[0], ambient[1], ambient[2]
    for j in range(_BATCH):
        nx, ny, nz = b[j + 3 * _BATCH], b[j + 4 * _BATCH], b[j + 5 * _BATCH]
        rx, ry, rz = b[j + 6 * _BATCH], b[j + 7 * _BATCH], b[j + 8 * _BATCH]
        ux, uy, uz = middle_x - b[j], middle_y - b[j + _BATCH], middle_z - b[j + 2 * _BATCH]
        shine, metal = b[j + 12 * _BATCH], b[j + 13 * _BATCH]
        scale = sided / np.sqrt(ux * ux + uy * uy + uz * uz + _TINY)
        facing = -(nx * rx + ny * ry + nz * rz)
        lift = (nx * ux + ny * uy + nz * uz) * scale
        mirror = max((rx * ux + ry * uy + rz * uz) * scale + (facing + facing) * lift, _ZERO)
        grazing = _ONE - min(max(facing, _ZERO), _ONE)
        grazing *= grazing * grazing * grazing * grazing * shine * shine
        around = _AROUND * (_ONE - metal) * (_ONE + _TOWARDS_LAMPS * lift)
        reflected = (_MIRRORED + mirror * mirror) * (shine * shine + metal * (_ONE - shine * shine))
        for k in range(3):
            color = b[j + (9 + k) * _BATCH]
            straight = _DIELECTRIC + metal * (color - _DIELECTRIC)
            fresnel = straight + (_ONE - straight) * grazing
            part = red if k == 0 else (green if k == 1 else blue)
            b[j + (15 + k) * _BATCH] = part * (color * around + fresnel * reflected)


@compiled
def _light_from(b: Float32[np.ndarray, " number"], lamp: Float32[np.ndarray, "6"]) -> None:
    """Put into rows 15 to 17 what points send of the light of a lamp, and into row 18 how much they face it.

    Lambert's law for the diffuse part. The glossy part is a lobe around the half-way vector, normalised, in the form
    of Schlick ("An inexpensive BRDF model", 1994), which needs no power.
    """
    lamp_x, lamp_y, lamp_z, red, green, blue = lamp[0], lamp[1], lamp[2], lamp[3], lamp[4], lamp[5]
    for j in range(_BATCH):
        nx, ny, nz = b[j + 3 * _BATCH], b[j + 4 * _BATCH], b[j + 5 * _BATCH]
        rx, ry, rz = b[j + 6 * _BATCH], b[j + 7 * _BATCH], b[j + 8 * _BATCH]
        lx, ly, lz = lamp_x - b[j], lamp_y - b[j + _BATCH], lamp_z - b[j + 2 * _BATCH]
        metal, exponent = b[j + 13 * _BATCH], b[j + 14 * _BATCH]
        scale = _ONE / np.sqrt(lx * lx + ly * ly + lz * lz + _TINY)
        incident = max((lx * nx + ly * ny + lz * nz) * scale, _ZERO)
        facing = -(nx * rx + ny * ry + nz * rz)
        opposed = max(_ONE - (lx * rx + ly * ry + lz * rz) * scale, _ZERO)  # half the square of the half-way vector
        cosine = max((incident + facing) / np.sqrt(opposed + opposed + _TINY), _ZERO)
        peak = b[j + 12 * _BATCH] * (exponent + _EIGHT) / _EIGHT
        lobe = peak * cosine / (exponent - exponent * cosine + cosine + _TINY)
        falloff = incident * (_REFERENCE_SQUARED * scale * scale)
        b[j + 18 * _BATCH] = incident
        for k in range(3):
            color = b[j + (9 + k) * _BATCH]
            straight = _DIELECTRIC + metal * (color - _DIELECTRIC)
            part = red if k == 0 else (green if k == 1 else blue)
            b[j + (15 + k) * _BATCH] = part * falloff * (color * (_ONE - metal) + straight * lobe)


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
        shares: Of each light that throws shadows, what reaches the points.
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
