"""Solid textures: patterns in space from which bodies are cut, so that no surface needs unwrapping."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float32, Int32

from assemblyhands_core.synthetic.compiled import compiled

Pattern = Literal["wood", "cloth", "checker", "speckle", "brushed", "mottle"]
"""Rings of a plank along x; weave; cubes in two colours; grains; fine scratches along x; soft stains."""


@dataclass(frozen=True)
class Texture:
    """A pattern between a body's albedo and a second colour.

    Attributes:
        pattern: Its kind.
        accent: The second colour, linear RGB.
        scale_mm: Distance of rings, threads, cubes, grains, scratches or stains.
        contrast: Share of the accent where the pattern is strongest, 0..1.
        seed: Two bodies with different seeds are cut from different places.
    """

    pattern: Pattern
    accent: tuple[float, float, float]
    scale_mm: float
    contrast: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.pattern not in get_args(Pattern) or not self.scale_mm > 0:
            raise ValueError(
                f"There is no texture {self.pattern!r} with a scale of {self.scale_mm} mm: use one of "
                f"{', '.join(get_args(Pattern))} and a positive scale."
            )

    def row(self) -> list[float]:
        """Return the texture as numbers for `paint`."""
        shift = np.random.default_rng(self.seed).uniform(-1e3, 1e3, 3) if self.seed else np.zeros(3)
        return [1.0 + get_args(Pattern).index(self.pattern), self.scale_mm, self.contrast, *self.accent, *shift]


_RANDOM = np.random.default_rng(0).random(4096).astype(np.float32)
_MASK = len(_RANDOM) - 1

NO_TEXTURE = [0.0] * 9
"""The row of a body of one colour."""


@compiled
def paint(
    albedo: Float32[np.ndarray, "point 3"],
    places_mm: Float32[np.ndarray, "point 3"],
    footprint_mm: Float32[np.ndarray, " point"],
    bodies: Int32[np.ndarray, " point"],
    textures: Float32[np.ndarray, "body 9"],
) -> None:
    """Mix the accent of each body's texture into its albedo, in place.

    Args:
        albedo: Linear RGB.
        places_mm: Where the points lie in their body's own frame.
        footprint_mm: Size of a pixel there; patterns too fine for it fade into their mean.
        bodies: Rows of `textures`.
        textures: From `Texture.row`.
    """
    for i in range(len(bodies)):
        texture = textures[bodies[i]]
        kind = int(texture[0])
        if kind == 0:
            continue
        scale = texture[1]
        x = (places_mm[i, 0] + texture[6]) / scale
        y = (places_mm[i, 1] + texture[7]) / scale
        z = (places_mm[i, 2] + texture[8]) / scale
        fine = max(0.0, 1.0 - 0.7 * footprint_mm[i] / scale)  # 1: the pattern is far larger than a pixel
        if kind == 1:
            share = _wood(x, y, z, fine)
        elif kind == 2:
            share = 0.5 + fine * (_weave(x, y, z) - 0.5) if fine > 0 else 0.5
        elif kind == 3:
            share = float((int(np.floor(x)) + int(np.floor(y)) + int(np.floor(z))) & 1)
        elif kind == 4:
            share = 0.3 + fine * (max(0.0, 3 * _noise(x, y, z) - 1.6) - 0.3) if fine > 0 else 0.3
        elif kind == 5:
            share = 0.5 + max(fine, 0.3) * (_noise(x * 0.02, y, z) - 0.5) * 1.6
        else:
            share = 0.6 * _noise(x, y, z) + 0.4 * _noise(3.1 * x, 3.1 * y, 3.1 * z)
        share = min(max(share, 0.0), 1.0) * texture[2]
        for channel in range(3):
            albedo[i, channel] += share * (texture[3 + channel] - albedo[i, channel])


@compiled
def _wood(x: float, y: float, z: float, fine: float) -> float:
    """Return distorted rings around an axis along x that lies below, and pores."""
    bend = _noise(0.03 * x, 0.3 * y, 0.3 * z)
    radius = np.sqrt((y + 9.0) ** 2 + (z + 23.0) ** 2) + 3.0 * bend
    ring = radius - np.floor(radius)
    rings = ring * ring * (1.0 - ring) * 6.0  # slow rise, quick fall: early and late wood
    pores = max(0.0, _noise(0.25 * x, 6.0 * y, 6.0 * z) - 0.62) * 2.2
    return float(fine * (0.75 * rings + pores) + (1 - fine) * 0.45 + 0.35 * (bend - 0.5))


@compiled
def _weave(x: float, y: float, z: float) -> float:
    """Return threads that cross over and under, with uneven thickness."""
    middle = _wave(y)
    over = middle * (_wave(x) + _wave(z))
    return float(0.5 + 0.28 * over + 0.3 * (_noise(0.37 * x, 0.37 * y, 0.37 * z) - 0.5))


@compiled
def _wave(x: float) -> float:
    """Return nearly a sine of period 1: parabolas."""
    x -= np.floor(x) + 0.5
    return float(16.0 * x * abs(x) - 8.0 * x)


@compiled
def _noise(x: float, y: float, z: float) -> float:
    """Return smooth noise in 0..1: random values at integer points, interpolated."""
    column, row, layer = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    x, y, z = x - column, y - row, z - layer
    x, y, z = x * x * (3 - 2 * x), y * y * (3 - 2 * y), z * z * (3 - 2 * z)
    a, b = column * 73856093, (column + 1) * 73856093  # mixed as by Teschner et al., "Optimized spatial hashing", 2003
    value = 0.0
    for corner in range(4):
        down, deep = corner & 1, corner >> 1
        line = ((row + down) * 19349663) ^ ((layer + deep) * 83492791)
        left, right = _RANDOM[(a ^ line) & _MASK], _RANDOM[(b ^ line) & _MASK]
        value += (left + x * (right - left)) * (y if down else 1 - y) * (z if deep else 1 - z)
    return float(value)
