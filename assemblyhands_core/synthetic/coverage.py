"""Which tiles of a picture the shadows of moving bodies may reach: only there rays to the lamps are cast again.

The answer errs to the safe side: a tile too many costs some rays, a tile too few would show.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64, UInt8, UInt16

from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.surfaces import FAR_MM, Surfaces

TILE_PX = 8
_CELLS = 512  # of the map of directions around a light, per side: 0.7° each


def num_tiles(width_px: int, height_px: int) -> tuple[int, int]:
    """Return rows and columns of tiles."""
    return -(-height_px // TILE_PX), -(-width_px // TILE_PX)


@dataclass(frozen=True, eq=False)
class LightMap:
    """The directions from a light, as a picture: equidistant around an axis.

    Attributes:
        position_mm: Of the light.
        radius_mm: Of the light.
        rotation: Rows are the axes of the picture; the third points into its middle.
    """

    position_mm: Float64[np.ndarray, "3"]
    radius_mm: float
    rotation: Float64[np.ndarray, "3 3"]

    @staticmethod
    def towards(
        position_mm: tuple[float, float, float], radius_mm: float, target_mm: Float64[np.ndarray, "3"]
    ) -> "LightMap":
        """Return the map around the direction to a target."""
        forward = target_mm - np.array(position_mm)
        forward /= max(float(np.linalg.norm(forward)), 1e-9)
        side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
        side /= np.linalg.norm(side)
        return LightMap(np.array(position_mm), radius_mm, np.stack((side, np.cross(forward, side), forward)))

    def spans(
        self, points_mm: Float32[np.ndarray, "row column sample 3"], known: Bool[np.ndarray, "row column sample"]
    ) -> Float32[np.ndarray, "row column 5"]:
        """Return for tiles of receiving points the cells they span (left, top, right, bottom) and the largest distance.

        A tile without known points spans nothing (right < left).
        """
        cells, distances = self._cells(points_mm)
        lower = np.where(known[..., None], cells, np.inf).min(axis=2)
        upper = np.where(known[..., None], cells, -np.inf).max(axis=2)
        margin = 0.5 + 0.15 * np.maximum(upper - lower, 0.0)
        farthest = np.where(known, distances, 0.0).max(axis=2)
        return np.concatenate((lower - margin, upper + margin, farthest[..., None]), axis=-1).astype(np.float32)

    def shadow_tiles(
        self, surfaces: Surfaces, spans: Float32[np.ndarray, "row column 5"]
    ) -> Bool[np.ndarray, "row column"]:
        """Return the tiles with receiving points that the surfaces may keep some of the light from."""
        if not len(surfaces.faces):
            return np.zeros(spans.shape[:2], dtype=bool)
        cells, distances = self._cells(surfaces.vertices_mm)
        marked = np.zeros((_CELLS, _CELLS), dtype=np.uint8)
        _mark_cells(cells.astype(np.float32), surfaces.faces, marked)
        total = np.zeros((_CELLS + 1, _CELLS + 1), dtype=np.int64)
        total[1:, 1:] = marked.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
        near = max(float(distances.min()), 1.0)
        return _meets(total, spans, self.radius_mm, near)

    def _cells(
        self, points_mm: Float32[np.ndarray, "*batch 3"]
    ) -> tuple[Float64[np.ndarray, "*batch 2"], Float64[np.ndarray, "*batch"]]:
        """Return where points lie on the map and how far they are."""
        local = (points_mm - self.position_mm) @ self.rotation.T
        across = np.hypot(local[..., 0], local[..., 1])
        angle = np.arctan2(across, local[..., 2])
        plane = local[..., :2] * (angle / np.maximum(across, 1e-9))[..., None]
        return (plane / np.pi + 1) * (_CELLS / 2), np.hypot(across, local[..., 2])


def tile_samples(
    distances_mm: Float32[np.ndarray, "height width"],
) -> tuple[Int32[np.ndarray, "row column 9"], Bool[np.ndarray, "row column 9"]]:
    """Return nine pixels of each tile as flat indices, and whether they show any surface."""
    height, width = distances_mm.shape
    rows, columns = num_tiles(width, height)
    inside = np.array([0, TILE_PX // 2, TILE_PX - 1])
    y = np.minimum(np.arange(rows)[:, None] * TILE_PX + inside, height - 1)
    x = np.minimum(np.arange(columns)[:, None] * TILE_PX + inside, width - 1)
    flat = (y[:, None, :, None] * width + x[None, :, None, :]).reshape(rows, columns, 9).astype(np.int32)
    return flat, distances_mm.ravel()[flat] < FAR_MM


@compiled
def _mark_cells(
    cells: Float32[np.ndarray, "vertex 2"], faces: Int32[np.ndarray, "face 3"], marked: UInt8[np.ndarray, "row column"]
) -> None:
    for face in range(len(faces)):
        a, b, c = cells[faces[face, 0]], cells[faces[face, 1]], cells[faces[face, 2]]
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        margin = 0.1 * (right - left + bottom - top)
        for row in range(max(int(top - margin), 0), min(int(bottom + margin) + 1, len(marked))):
            for column in range(max(int(left - margin), 0), min(int(right + margin) + 1, len(marked))):
                marked[row, column] = 1


@compiled
def _meets(
    total: Int64[np.ndarray, "row column"], spans: Float32[np.ndarray, "row column 5"], radius: float, near: float
) -> Bool[np.ndarray, "row column"]:
    """Look the tiles up in the sums of marked cells, wider by the penumbra.

    A body at distance d and a receiver at D see the lamp's rim from its middle by at most r (1/d - 1/D) apart.
    """
    met = np.zeros(spans.shape[:2], np.bool_)
    last = len(total) - 1
    for row in range(spans.shape[0]):
        for column in range(spans.shape[1]):
            left, top, right, bottom, far = spans[row, column]
            if right < left:
                continue
            blur = radius * max(1 / near - 1 / max(far, near), 0.0) * last / (2 * np.pi)
            x0, y0 = min(max(int(left - blur), 0), last), min(max(int(top - blur), 0), last)
            x1, y1 = min(max(int(right + blur) + 1, 0), last), min(max(int(bottom + blur) + 1, 0), last)
            met[row, column] = total[y1, x1] - total[y0, x1] - total[y1, x0] + total[y0, x0] > 0
    return met


@compiled
def lit_pixels(
    tiles: Bool[np.ndarray, "row column"],
    direct: UInt16[np.ndarray, "height width 3"],
    is_covered: UInt8[np.ndarray, "height width"],
) -> Int32[np.ndarray, " pixel"]:
    """Return the flat indices of the pixels of tiles that get light and are not covered, tile by tile."""
    height, width = is_covered.shape
    pixels = np.empty(np.sum(tiles) * TILE_PX * TILE_PX, np.int32)
    count = 0
    for row in range(tiles.shape[0]):
        for column in range(tiles.shape[1]):
            if tiles[row, column]:
                for y in range(row * TILE_PX, min((row + 1) * TILE_PX, height)):
                    for x in range(column * TILE_PX, min((column + 1) * TILE_PX, width)):
                        if not is_covered[y, x] and (direct[y, x, 0] or direct[y, x, 1] or direct[y, x, 2]):
                            pixels[count] = y * width + x
                            count += 1
    return pixels[:count]
