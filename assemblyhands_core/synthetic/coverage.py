"""Which tiles of a picture the shadows of moving bodies may reach: only there rays to the lamps are cast again.

The answer errs to the safe side: a tile too many costs some rays, a tile too few would show.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.surfaces import FAR_MM, Surfaces

TILE_PX = 8
_CELLS = 512  # of the map of directions around a light, per side: 0.7° each


def num_tiles(height_px: int, width_px: int) -> tuple[int, int]:
    """Return rows and columns of tiles."""
    return -(-height_px // TILE_PX), -(-width_px // TILE_PX)


def tile_samples(shape: tuple[int, ...]) -> Int32[np.ndarray, " sample"]:
    """Return nine pixels of each tile of a picture, as flat indices."""
    height, width = shape
    rows, columns = num_tiles(height, width)
    inside = np.array([0, TILE_PX // 2, TILE_PX - 1], dtype=np.int32)
    y = np.minimum(np.arange(rows, dtype=np.int32)[:, None] * TILE_PX + inside, height - 1)
    x = np.minimum(np.arange(columns, dtype=np.int32)[:, None] * TILE_PX + inside, width - 1)
    return np.asarray((y[:, None, :, None] * width + x[None, :, None, :]).ravel())


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
        self, positions_mm: Float32[np.ndarray, "sample 3"], distances_mm: Float32[np.ndarray, "height width"]
    ) -> Float32[np.ndarray, "row column 5"]:
        """Return for each tile of a picture the cells that the points in it span and their largest distance.

        Args:
            positions_mm: What the pixels of `tile_samples` show.
            distances_mm: Of the picture; tiles that show nothing span nothing (right < left).

        Returns:
            Left, top, right, bottom, in cells, and the distance in mm from the light.
        """
        cells, distances = self.cells(positions_mm)
        is_shown = distances_mm.ravel()[tile_samples(distances_mm.shape)] < FAR_MM
        return _spans(cells, distances, is_shown, *num_tiles(*distances_mm.shape))

    def cells(
        self, points_mm: Float32[np.ndarray, "point 3"]
    ) -> tuple[Float32[np.ndarray, "point 2"], Float32[np.ndarray, " point"]]:
        """Return where points lie on the map and how far they are."""
        return _cells(points_mm, self.position_mm, self.rotation)


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """Where around a light the shadows of some surfaces lie; made once for all views of an instant.

    Attributes:
        around: The map of directions.
        covered: Sums over all cells above and left of each cell's corner: how many of them the surfaces touch.
        nearest_mm: Of the surfaces to the light.
    """

    around: LightMap
    covered: Int32[np.ndarray, "row column"]
    nearest_mm: float

    @staticmethod
    def of(around: LightMap, surfaces: Surfaces) -> "ShadowMap":
        """Return the shadows of surfaces."""
        covered = np.zeros((_CELLS + 1, _CELLS + 1), dtype=np.int32)
        if not len(surfaces.faces):
            return ShadowMap(around, covered, 1.0)
        cells, distances = around.cells(surfaces.vertices_mm)
        marked = np.zeros((_CELLS, _CELLS), dtype=np.uint8)
        _mark_cells(cells, surfaces.faces, marked)
        covered[1:, 1:] = marked.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
        return ShadowMap(around, covered, max(float(distances.min()), 1.0))

    def tiles(self, spans: Float32[np.ndarray, "row column 5"]) -> Bool[np.ndarray, "row column"]:
        """Return which tiles, by their spans, show points that the surfaces may keep some of the light from."""
        return _meets(self.covered, spans, self.around.radius_mm, self.nearest_mm)


@compiled
def _cells(
    points: Float32[np.ndarray, "point 3"], light: Float64[np.ndarray, "3"], rotation: Float64[np.ndarray, "3 3"]
) -> tuple[Float32[np.ndarray, "point 2"], Float32[np.ndarray, " point"]]:
    cells, distances = np.empty((len(points), 2), np.float32), np.empty(len(points), np.float32)
    for i in range(len(points)):
        px, py, pz = points[i, 0] - light[0], points[i, 1] - light[1], points[i, 2] - light[2]
        x = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
        y = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz
        across = np.sqrt(x * x + y * y)
        scale = np.arctan2(across, z) / max(across, 1e-9)
        cells[i, 0], cells[i, 1] = (x * scale / np.pi + 1) * (_CELLS / 2), (y * scale / np.pi + 1) * (_CELLS / 2)
        distances[i] = np.sqrt(across * across + z * z)
    return cells, distances


@compiled
def _spans(
    cells: Float32[np.ndarray, "sample 2"],
    distances: Float32[np.ndarray, " sample"],
    is_shown: Bool[np.ndarray, " sample"],
    rows: int,
    columns: int,
) -> Float32[np.ndarray, "row column 5"]:
    spans = np.empty((rows, columns, 5), np.float32)
    per_tile = len(cells) // (rows * columns)
    for tile in range(rows * columns):
        left, top, right, bottom, far = np.inf, np.inf, -np.inf, -np.inf, 0.0
        for i in range(tile * per_tile, (tile + 1) * per_tile):
            if is_shown[i]:
                left, right = min(left, cells[i, 0]), max(right, cells[i, 0])
                top, bottom = min(top, cells[i, 1]), max(bottom, cells[i, 1])
                far = max(far, distances[i])
        wide, high = 0.5 + 0.15 * max(right - left, 0.0), 0.5 + 0.15 * max(bottom - top, 0.0)
        span = spans[tile // columns, tile % columns]
        span[0], span[1], span[2], span[3], span[4] = left - wide, top - high, right + wide, bottom + high, far
    return spans


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
    total: Int32[np.ndarray, "row column"], spans: Float32[np.ndarray, "row column 5"], radius: float, near: float
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
