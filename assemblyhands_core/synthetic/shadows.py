"""Soft shadows: one ray per pixel and lamp, towards one of sixteen points on the lamp, then joined with its neighbours.

Which of the points a pixel aims at repeats every 4 × 4 pixels, so that any 4 × 4 of them together see the whole lamp,
and nothing has to be drawn at random ("interleaved sampling", Keller and Heidrich 2001). One pixel of each 4 × 4 block
is asked first; where it agrees with those of the blocks around, the others need not be.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from assemblyhands_core.synthetic.bodies import Light
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.surfaces import Surfaces

Places = Callable[[Int32[np.ndarray, " asked"]], Float32[np.ndarray, "asked 3"]]
"""The points that pixels show, in mm and a little off their surface, by their place in a list of pixels."""

_BLOCKED, _LIT, _UNKNOWN = 0, 1, 2  # what a pixel's ray found; unknown also where the surface faces away
_SAW_BLOCKED, _SAW_LIT = 1, 2  # what the rays of a block found, as bits
_PERIOD = 4
_GAP_MM = 5.0  # neighbours further behind one another, plus some pixels' size, lie on different surfaces
_NO_NORMALS = np.zeros((0, 3), np.float32)


@dataclass(frozen=True, eq=False)
class LampView:
    """What the pixels of a picture see of one lamp.

    Attributes:
        lamp: It.
        found: Of each pixel's own ray.
        blocks: Of all rays in 4 × 4 pixels.
    """

    lamp: Light
    found: UInt8[np.ndarray, "height width"]
    blocks: UInt8[np.ndarray, "row column"]

    @staticmethod
    def empty(lamp: Light, shape: tuple[int, int]) -> "LampView":
        """Return the view of a picture of which no pixel has been asked."""
        blocks = -(-shape[0] // _PERIOD), -(-shape[1] // _PERIOD)
        return LampView(lamp, np.full(shape, _UNKNOWN, dtype=np.uint8), np.zeros(blocks, dtype=np.uint8))

    def ask(
        self,
        blockers: tuple[Surfaces, ...],
        pixels: Int32[np.ndarray, " point"],
        places: Places,
        normals: Float32[np.ndarray, "point 3"] | None = None,
    ) -> None:
        """Find out what some pixels see of the lamp.

        Args:
            blockers: Asked one after the other, for the points that those before leave lit.
            pixels: Flat indices.
            places: Of the points that they show.
            normals: Points that face away from the lamp see nothing of it and cost no ray; None if all face it.
        """
        if self.lamp.casts_shadow:
            first, others = _one_per_block(pixels, self.found.shape[1])
            self._cast(blockers, pixels, places, normals, first)
            self._cast(blockers, pixels, places, normals, _undecided(pixels, others, self.found, self.blocks))

    def shares(
        self,
        pixels: Int32[np.ndarray, " point"],
        ids: UInt8[np.ndarray, "height width"],
        distances_mm: Float32[np.ndarray, "height width"],
        pixel_rad: float,
    ) -> Float32[np.ndarray, " point"]:
        """Return the share of the lamp that pixels see, from their neighbours on the same surface.

        The weights 1/2 1 1 1 1/2 along both axes count each of the 4 × 4 points of the lamp once.

        Args:
            pixels: Flat indices of the pixels asked for.
            ids: Objects in the picture.
            distances_mm: Of what the pixels show.
            pixel_rad: Angle between neighbouring rays.
        """
        if not self.lamp.casts_shadow:
            return np.ones(len(pixels), dtype=np.float32)
        return _smoothed(pixels, self.found, self.blocks, ids, distances_mm, pixel_rad)

    def _cast(
        self,
        blockers: tuple[Surfaces, ...],
        pixels: Int32[np.ndarray, " point"],
        places: Places,
        normals: Float32[np.ndarray, "point 3"] | None,
        asked: Int32[np.ndarray, " asked"],
    ) -> None:
        points = np.array(self.lamp.position_mm, dtype=np.float32) + _lamp_points(self.lamp.radius_mm)
        facing = _NO_NORMALS if normals is None else normals
        asked, origins, segments = _segments(places(asked), facing, pixels, asked, self.found.shape[1], points)
        is_blocked = np.zeros(len(asked), dtype=bool)
        for surfaces in blockers:
            free = np.flatnonzero(~is_blocked)
            part = (origins, segments) if len(free) == len(asked) else (origins[free], segments[free])
            is_blocked[free] = surfaces.blocked(*part)
        _note(pixels, asked, is_blocked.view(np.uint8), self.found, self.blocks)


def _lamp_points(radius_mm: float) -> Float32[np.ndarray, "16 3"]:
    """Return points spread evenly over a sphere around the origin, in an order that scatters neighbours."""
    index = np.arange(_PERIOD**2)
    z = (2 * index + 1) / len(index) - 1
    angle = index * np.pi * (3 - np.sqrt(5))
    points = np.stack((np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z), axis=-1)
    order = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5]  # Bayer's: far apart next to one another
    return np.asarray(radius_mm * points[order], dtype=np.float32)


@compiled
def _one_per_block(
    pixels: Int32[np.ndarray, " point"], width: int
) -> tuple[Int32[np.ndarray, " first"], Int32[np.ndarray, " other"]]:
    """Split a list of pixels, by place: one of each 4 × 4 block, not always the same one, and the others."""
    first, others = np.empty(len(pixels), np.int32), np.empty(len(pixels), np.int32)
    num_first, num_others = 0, 0
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        across, down = (column // 4 + 2 * (row // 4)) % 4, (row // 4 + column // 8) % 4
        if column % 4 == across and row % 4 == down:
            first[num_first] = i
            num_first += 1
        else:
            others[num_others] = i
            num_others += 1
    return first[:num_first], others[:num_others]


@compiled
def _around(blocks: UInt8[np.ndarray, "row column"], row: int, column: int) -> int:
    """Return what the rays of a block and of those around it found."""
    seen = 0
    for y in range(max(row - 1, 0), min(row + 2, blocks.shape[0])):
        for x in range(max(column - 1, 0), min(column + 2, blocks.shape[1])):
            seen |= blocks[y, x]
    return seen


@compiled
def _undecided(
    pixels: Int32[np.ndarray, " point"],
    others: Int32[np.ndarray, " other"],
    found: UInt8[np.ndarray, "height width"],
    blocks: UInt8[np.ndarray, "row column"],
) -> Int32[np.ndarray, " asked"]:
    """Return which pixels have to be asked, because the blocks around know nothing or do not agree; note the rest."""
    width = found.shape[1]
    asked = np.empty(len(others), np.int32)
    count = 0
    for i in range(len(others)):
        row, column = pixels[others[i]] // width, pixels[others[i]] % width
        seen = _around(blocks, row // 4, column // 4)
        if blocks[row // 4, column // 4] == 0 or seen == 3:
            asked[count] = others[i]
            count += 1
        else:
            found[row, column] = _BLOCKED if seen == _SAW_BLOCKED else _LIT
    return asked[:count]


@compiled
def _segments(
    places: Float32[np.ndarray, "asked 3"],
    normals: Float32[np.ndarray, "facing 3"],
    pixels: Int32[np.ndarray, " point"],
    asked: Int32[np.ndarray, " asked"],
    width: int,
    lamp: Float32[np.ndarray, "16 3"],
) -> tuple[Int32[np.ndarray, " ray"], Float32[np.ndarray, "ray 3"], Float32[np.ndarray, "ray 3"]]:
    """Return, for the points that face the lamp, their place in the list, the point and the way to the lamp."""
    facing = np.empty(len(asked), np.int32)
    origins, segments = np.empty((len(asked), 3), np.float32), np.empty((len(asked), 3), np.float32)
    count = 0
    for i in range(len(asked)):
        pixel = pixels[asked[i]]
        target = (pixel // width) % _PERIOD * _PERIOD + (pixel % width) % _PERIOD
        x, y, z = lamp[target, 0] - places[i, 0], lamp[target, 1] - places[i, 1], lamp[target, 2] - places[i, 2]
        j = asked[i]
        if len(normals) == 0 or x * normals[j, 0] + y * normals[j, 1] + z * normals[j, 2] > 0:
            facing[count] = j
            segments[count, 0], segments[count, 1], segments[count, 2] = x, y, z
            origins[count, 0], origins[count, 1], origins[count, 2] = places[i, 0], places[i, 1], places[i, 2]
            count += 1
    return facing[:count], origins[:count], segments[:count]


@compiled
def _note(
    pixels: Int32[np.ndarray, " point"],
    asked: Int32[np.ndarray, " ray"],
    is_blocked: UInt8[np.ndarray, " ray"],
    found: UInt8[np.ndarray, "height width"],
    blocks: UInt8[np.ndarray, "row column"],
) -> None:
    width = found.shape[1]
    for i in range(len(asked)):
        row, column = pixels[asked[i]] // width, pixels[asked[i]] % width
        found[row, column] = _BLOCKED if is_blocked[i] else _LIT
        blocks[row // 4, column // 4] |= _SAW_BLOCKED if is_blocked[i] else _SAW_LIT


@compiled
def _smoothed(
    pixels: Int32[np.ndarray, " point"],
    found: UInt8[np.ndarray, "height width"],
    blocks: UInt8[np.ndarray, "row column"],
    ids: UInt8[np.ndarray, "height width"],
    distances: Float32[np.ndarray, "height width"],
    pixel_rad: float,
) -> Float32[np.ndarray, " point"]:
    height, width = found.shape
    shares = np.empty(len(pixels), np.float32)
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        seen = _around(blocks, row // 4, column // 4)
        if seen != _SAW_BLOCKED + _SAW_LIT:
            shares[i] = np.float32(0) if seen == _SAW_BLOCKED else np.float32(1)
            continue
        own, distance = ids[row, column], distances[row, column]
        gap = _GAP_MM + 4 * pixel_rad * distance
        lit, weights = np.float32(0), np.float32(0)
        for y in range(max(row - 2, 0), min(row + 3, height)):
            weight_y = np.float32(0.5) if abs(y - row) == 2 else np.float32(1)
            for x in range(max(column - 2, 0), min(column + 3, width)):
                if found[y, x] != _UNKNOWN and ids[y, x] == own and abs(distances[y, x] - distance) < gap:
                    weight = weight_y * (np.float32(0.5) if abs(x - column) == 2 else np.float32(1))
                    weights += weight
                    lit += weight * found[y, x]
        shares[i] = lit / weights if weights > 0 else np.float32(1)
    return shares
