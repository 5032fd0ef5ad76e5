"""Soft shadows: a ray from every second pixel to one of eight points on a lamp, then joined with its neighbours'.

Which of the points a pixel aims at repeats every 4 × 4 pixels, so that any 4 × 4 of them together see the whole lamp,
and nothing has to be drawn at random ("interleaved sampling", Keller and Heidrich 2001). One pixel of each 4 × 4 block
is asked first, so that 3 × 3 blocks see all points; where these agree, the other pixels need not be asked.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8

from assemblyhands_core.synthetic.bodies import Light
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.surfaces import Surfaces

BLOCK_PX = 4

_BLOCKED, _LIT, _UNKNOWN = 0, 1, 2  # what a pixel's ray found; unknown where none was cast
_SAW_BLOCKED, _SAW_LIT = 1, 2  # what the rays of a block found, as bits
_GAP_MM, _FOUR = (
    np.float32(5.0),
    np.float32(4.0),
)  # neighbours further behind one another, plus some pixels' size, lie on different surfaces
_FIRST, _ASKED, _ALL = 0, 1, 2  # pixels of a block: the one asked first, every second, every


def _taps(parity: int) -> list[tuple[int, int, int]]:
    """Return row, column and four times the weight of the pixels that are asked around one of a colour."""
    around = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if (x + y + parity) % 2 == 0]
    return [(y, x, (2 - abs(y) // 2) * (2 - abs(x) // 2)) for y, x in around]


_TAPS = np.array([_taps(0), [*_taps(1), (0, 0, 0)]])


@dataclass(frozen=True, eq=False)
class LampView:
    """What the pixels of a picture see of one lamp.

    Attributes:
        lamp: It.
        found: By each pixel's own ray.
        blocks: By all rays in each block of pixels.
    """

    lamp: Light
    found: UInt8[np.ndarray, "height width"]
    blocks: UInt8[np.ndarray, "row column"]

    @staticmethod
    def empty(lamp: Light, shape: tuple[int, int]) -> "LampView":
        """Return the view of a picture of which no pixel has been asked."""
        blocks = -(-shape[0] // BLOCK_PX), -(-shape[1] // BLOCK_PX)
        return LampView(lamp, np.full(shape, _UNKNOWN, dtype=np.uint8), np.zeros(blocks, dtype=np.uint8))

    def ask(
        self,
        blockers: tuple[Surfaces, ...],
        pixels: Int32[np.ndarray, " point"],
        positions_mm: Float32[np.ndarray, "point 3"],
        is_facing: Bool[np.ndarray, " point"],
    ) -> None:
        """Find out what some pixels see of the lamp.

        Args:
            blockers: Asked one after the other, for the points that those before leave lit.
            pixels: Flat indices.
            positions_mm: What they show, a little off the surface.
            is_facing: Whether that faces the lamp; the others are not asked.
        """
        width = self.found.shape[1]
        self._cast(blockers, *_picked(_firsts(pixels, is_facing, width), pixels, positions_mm))
        chosen = _undecided(pixels, is_facing, self.blocks, _with_neighbours(self.blocks), width)
        self._cast(blockers, *_picked(chosen, pixels, positions_mm))

    def ask_area(
        self,
        blockers: tuple[Surfaces, ...],
        area: Bool[np.ndarray, "row column"],
        is_shown: Bool[np.ndarray, "height width"],
        positions_mm: Callable[[Int32[np.ndarray, " pixel"]], Float32[np.ndarray, "pixel 3"]],
    ) -> Int32[np.ndarray, " pixel"]:
        """Find out what the pixels in an area see of the lamp.

        Args:
            blockers: As for `ask`.
            area: Blocks of pixels.
            is_shown: Which pixels count; all of them have to face the lamp.
            positions_mm: Returns what pixels show.

        Returns:
            Flat indices of those that may see less than all of it.
        """
        pixels = _area_pixels(area, is_shown, _FIRST)
        self._cast(blockers, pixels, positions_mm(pixels))
        disagree = _with_neighbours(self.blocks) == _SAW_BLOCKED + _SAW_LIT
        pixels = _area_pixels(area & (disagree | (self.blocks == 0)), is_shown, _ASKED)
        self._cast(blockers, pixels, positions_mm(pixels))
        return _area_pixels(area & (_with_neighbours(self.blocks) & _SAW_BLOCKED > 0), is_shown, _ALL)

    def shares(
        self,
        pixels: Int32[np.ndarray, " point"],
        is_facing: Bool[np.ndarray, " point"],
        ids: UInt8[np.ndarray, "height width"],
        distances_mm: Float32[np.ndarray, "height width"],
        pixel_rad: float,
    ) -> Float32[np.ndarray, " point"]:
        """Return the share of the lamp that pixels see, from their neighbours on the same surface.

        The weights 1/2 1 1 1 1/2 along both axes count each of the eight points of the lamp once.

        Args:
            pixels: Flat indices of the pixels asked for.
            is_facing: Whether they face the lamp; the others get nothing of it, so that their share is 1.
            ids: Objects in the picture.
            distances_mm: Of what the pixels show.
            pixel_rad: Angle between neighbouring rays.
        """
        return _smoothed(pixels, is_facing, self.found, self.blocks, ids, distances_mm, np.float32(pixel_rad))

    def _cast(
        self,
        blockers: tuple[Surfaces, ...],
        pixels: Int32[np.ndarray, " asked"],
        origins: Float32[np.ndarray, "asked 3"],
    ) -> None:
        points = np.array(self.lamp.position_mm, dtype=np.float32) + _lamp_points(self.lamp.radius_mm)
        segments = _segments(pixels, origins, self.found.shape[1], points)
        is_blocked = blockers[0].blocked(origins, segments)
        for surfaces in blockers[1:]:
            free = _free(is_blocked)
            is_blocked[free] = surfaces.blocked(_rows(free, origins), _rows(free, segments))
        _note(pixels, is_blocked, self.found, self.blocks)


@lru_cache(16)
def _lamp_points(radius_mm: float) -> Float32[np.ndarray, "8 3"]:
    """Return points spread evenly over a sphere around the origin, in an order that scatters neighbours."""
    index = np.array([0, 4, 6, 2, 3, 7, 5, 1])
    z = (2 * index + 1) / len(index) - 1
    angle = index * np.pi * (3 - np.sqrt(5))
    points = np.stack((np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z), axis=-1)
    return np.asarray(radius_mm * points, dtype=np.float32)


@compiled
def _target(row: int, column: int) -> int:
    """Return which of the eight points a pixel aims at, -1 for none: a chessboard of which the white squares do."""
    return -1 if (row + column) & 1 else 2 * (row & 3) + ((column & 3) >> 1)


@compiled
def _is_first(row: int, column: int) -> bool:
    """Tell whether a pixel is the one of its block asked first; in any 3 × 3 blocks these aim at all points."""
    return bool(_target(row, column) == (column // 4 + 3 * (row // 4)) & 7)


@compiled
def _firsts(
    pixels: Int32[np.ndarray, " point"], is_facing: Bool[np.ndarray, " point"], width: int
) -> Int32[np.ndarray, " first"]:
    """Return, by place in the list, the pixels asked first."""
    firsts = np.empty(len(pixels), np.int32)
    count = 0
    for i in range(len(pixels)):
        if is_facing[i] and _is_first(pixels[i] // width, pixels[i] % width):
            firsts[count] = i
            count += 1
    return firsts[:count]


@compiled
def _picked(
    chosen: Int32[np.ndarray, " some"], pixels: Int32[np.ndarray, " point"], positions: Float32[np.ndarray, "point 3"]
) -> tuple[Int32[np.ndarray, " some"], Float32[np.ndarray, "some 3"]]:
    """Return some of the pixels and what they show."""
    picked = np.empty(len(chosen), np.int32)
    for i in range(len(chosen)):
        picked[i] = pixels[chosen[i]]
    return picked, _rows(chosen, positions)


@compiled
def _rows(chosen: Int32[np.ndarray, " some"], vectors: Float32[np.ndarray, "point 3"]) -> Float32[np.ndarray, "some 3"]:
    rows = np.empty((len(chosen), 3), np.float32)
    for i in range(len(chosen)):
        rows[i, 0], rows[i, 1], rows[i, 2] = vectors[chosen[i], 0], vectors[chosen[i], 1], vectors[chosen[i], 2]
    return rows


@compiled
def _free(is_blocked: Bool[np.ndarray, " ray"]) -> Int32[np.ndarray, " free"]:
    free = np.empty(len(is_blocked), np.int32)
    count = 0
    for i in range(len(is_blocked)):
        if not is_blocked[i]:
            free[count] = i
            count += 1
    return free[:count]


@compiled
def _area_pixels(
    area: Bool[np.ndarray, "row column"], is_shown: Bool[np.ndarray, "height width"], which: int
) -> Int32[np.ndarray, " pixel"]:
    """Return the flat indices of the pixels of blocks that count, block by block so that rays stay together."""
    height, width = is_shown.shape
    pixels = np.empty(np.sum(area) * 16, np.int32)
    count = 0
    for row in range(area.shape[0]):
        for column in range(area.shape[1]):
            if area[row, column]:
                for y in range(4 * row, min(4 * row + 4, height)):
                    for x in range(4 * column, min(4 * column + 4, width)):
                        if which == _FIRST and not _is_first(y, x):
                            continue
                        if is_shown[y, x] and (which == _ALL or _target(y, x) >= 0):
                            pixels[count] = y * width + x
                            count += 1
    return pixels[:count]


@compiled
def _with_neighbours(blocks: UInt8[np.ndarray, "row column"]) -> UInt8[np.ndarray, "row column"]:
    """Return what the rays of blocks and of those around them found."""
    rows, columns = blocks.shape
    seen = np.zeros_like(blocks)
    for row in range(rows):
        for column in range(columns):
            if blocks[row, column]:
                for y in range(max(row - 1, 0), min(row + 2, rows)):
                    for x in range(max(column - 1, 0), min(column + 2, columns)):
                        seen[y, x] |= blocks[row, column]
    return seen


@compiled
def _undecided(
    pixels: Int32[np.ndarray, " point"],
    is_facing: Bool[np.ndarray, " point"],
    blocks: UInt8[np.ndarray, "row column"],
    around: UInt8[np.ndarray, "row column"],
    width: int,
) -> Int32[np.ndarray, " asked"]:
    """Return, by place in the list, the pixels to ask because the blocks around know nothing or do not agree."""
    asked = np.empty(len(pixels), np.int32)
    count = 0
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        if not is_facing[i] or _target(row, column) < 0 or _is_first(row, column):
            continue
        if blocks[row // 4, column // 4] == 0 or around[row // 4, column // 4] == _SAW_BLOCKED + _SAW_LIT:
            asked[count] = i
            count += 1
    return asked[:count]


@compiled
def _segments(
    pixels: Int32[np.ndarray, " asked"],
    positions: Float32[np.ndarray, "asked 3"],
    width: int,
    lamp: Float32[np.ndarray, "8 3"],
) -> Float32[np.ndarray, "asked 3"]:
    """Return the ways from points to the lamp."""
    segments = np.empty((len(pixels), 3), np.float32)
    for i in range(len(pixels)):
        target = _target(pixels[i] // width, pixels[i] % width)
        for axis in range(3):
            segments[i, axis] = lamp[target, axis] - positions[i, axis]
    return segments


@compiled
def _note(
    pixels: Int32[np.ndarray, " ray"],
    is_blocked: Bool[np.ndarray, " ray"],
    found: UInt8[np.ndarray, "height width"],
    blocks: UInt8[np.ndarray, "row column"],
) -> None:
    width = found.shape[1]
    for i in range(len(pixels)):
        row, column = pixels[i] // width, pixels[i] % width
        found[row, column] = _BLOCKED if is_blocked[i] else _LIT
        blocks[row // 4, column // 4] |= _SAW_BLOCKED if is_blocked[i] else _SAW_LIT


@compiled
def _smoothed(
    pixels: Int32[np.ndarray, " point"],
    is_facing: Bool[np.ndarray, " point"],
    found: UInt8[np.ndarray, "height width"],
    blocks: UInt8[np.ndarray, "row column"],
    ids: UInt8[np.ndarray, "height width"],
    distances: Float32[np.ndarray, "height width"],
    pixel_rad: np.float32,
) -> Float32[np.ndarray, " point"]:
    height, width = found.shape
    shares = np.ones(len(pixels), np.float32)
    for i in range(len(pixels)):
        if not is_facing[i]:
            continue
        row, column = pixels[i] // width, pixels[i] % width
        top, bottom = max(row - 2, 0), min(row + 2, height - 1)
        left, right = max(column - 2, 0), min(column + 2, width - 1)
        seen = blocks[top // 4, left // 4] | blocks[top // 4, right // 4]
        seen |= blocks[bottom // 4, left // 4] | blocks[bottom // 4, right // 4]
        if seen == 0:  # nothing was asked so near
            seen = _seen_around(blocks, row // 4, column // 4)
        if seen != _SAW_BLOCKED + _SAW_LIT:
            shares[i] = 0.0 if seen == _SAW_BLOCKED else 1.0
            continue
        own, distance = ids[row, column], distances[row, column]
        gap = _GAP_MM + pixel_rad * (_FOUR * distance)
        lit, weights = 0, 0
        for tap in range(12 + (row + column + 1) % 2):
            y, x = row + _TAPS[(row + column) & 1, tap, 0], column + _TAPS[(row + column) & 1, tap, 1]
            if not (0 <= y < height and 0 <= x < width):
                continue
            value = found[y, x]
            if value == _UNKNOWN:  # not asked because all around agreed
                if blocks[y // 4, x // 4] != _SAW_LIT:
                    continue
                value = _LIT
            is_near = (ids[y, x] == own) & (abs(distances[y, x] - distance) < gap)
            weight = _TAPS[(row + column) & 1, tap, 2] * is_near
            weights += weight
            lit += weight * value
        if weights > 0:
            shares[i] = lit / weights
    return shares


@compiled
def _seen_around(blocks: UInt8[np.ndarray, "row column"], row: int, column: int) -> int:
    seen = 0
    for y in range(max(row - 1, 0), min(row + 2, blocks.shape[0])):
        for x in range(max(column - 1, 0), min(column + 2, blocks.shape[1])):
            seen |= blocks[y, x]
    return seen
