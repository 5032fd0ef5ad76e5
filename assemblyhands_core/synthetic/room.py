"""What stands still: table, chair, legs, floor, walls and the lamps."""

from typing import Final

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.bodies import Body, Color, Light
from assemblyhands_core.synthetic.figure import Shape
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.motion import shifted
from assemblyhands_core.synthetic.person import HIPS_WORLD_MM, Subject
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM
from assemblyhands_core.synthetic.solids import Box, tapered_capsule

TABLE_ID: Final = 200
FURNITURE_ID: Final = 201
ROOM_ID: Final = 202
LEGS_ID: Final = 8

_FLOOR_Y_MM: Final = TABLE_TOP_Y_MM - 735.0
_TABLE_X_MM: Final = (-170.0, 560.0)
_TABLE_Z_MM: Final = (-520.0, 680.0)
_TABLES: Final[tuple[tuple[Color, Color], ...]] = (
    ((0.46, 0.29, 0.16), (0.30, 0.17, 0.08)),
    ((0.50, 0.38, 0.26), (0.37, 0.26, 0.16)),
    ((0.20, 0.11, 0.06), (0.11, 0.055, 0.03)),
    ((0.44, 0.43, 0.42), (0.36, 0.36, 0.35)),
)
_WALLS: Final[tuple[Color, ...]] = ((0.55, 0.53, 0.50), (0.42, 0.46, 0.50), (0.50, 0.50, 0.44), (0.20, 0.21, 0.23))
_POSTERS: Final[tuple[Color, ...]] = ((0.45, 0.12, 0.08), (0.08, 0.22, 0.40), (0.55, 0.45, 0.15), (0.12, 0.30, 0.16))


def furnish(subject: Subject, rng: np.random.Generator) -> tuple[Body, ...]:
    """Return everything that never moves, the sitter's legs included."""
    return (*_table(rng), *_chair(rng), *_legs(subject, rng), *_walls(rng))


def draw_lights(rng: np.random.Generator) -> tuple[Light, ...]:
    """Draw two ceiling lamps that cast shadows and a faint window."""
    warmth = float(rng.uniform(0.86, 1.06))
    lamps = []
    for z_mm in (float(rng.uniform(-650, -250)), float(rng.uniform(350, 750))):
        power = float(rng.uniform(0.95, 1.45))
        place = (float(rng.uniform(-100, 500)), float(rng.uniform(1300, 1600)), z_mm)
        lamps.append(Light(place, float(rng.uniform(110, 220)), (power, power * (0.5 + 0.5 * warmth), power * warmth)))
    side = 1.0 if rng.random() < 0.5 else -1.0
    window = Light((900.0, 700.0, side * 1700.0), 300.0, (0.7, 0.75, 0.8), casts_shadow=False)
    return (*lamps, window)


def _table(rng: np.random.Generator) -> list[Body]:
    color, accent = _TABLES[int(rng.integers(len(_TABLES)))]
    wood = Texture("wood", accent, 14.0, 0.9, int(rng.integers(1, 1000)))
    if max(color) - min(color) < 0.1:
        wood = Texture("speckle", accent, 4.0, 0.8, int(rng.integers(1, 1000)))
    top = _slab("table", TABLE_ID, _TABLE_X_MM, (TABLE_TOP_Y_MM - 30.0, TABLE_TOP_Y_MM), _TABLE_Z_MM, color, wood)
    legs = [
        _slab(
            "table leg", FURNITURE_ID, (x - 25, x + 25), (_FLOOR_Y_MM, TABLE_TOP_Y_MM - 31.0), (z - 25, z + 25), color
        )
        for x in (_TABLE_X_MM[0] + 60, _TABLE_X_MM[1] - 60)
        for z in (_TABLE_Z_MM[0] + 60, _TABLE_Z_MM[1] - 60)
    ]
    return [top, *legs]


def _chair(rng: np.random.Generator) -> list[Body]:
    x, y, z = HIPS_WORLD_MM
    color: Color = (0.05, 0.05, 0.06) if rng.random() < 0.5 else (0.25, 0.07, 0.05)
    seat = _slab("seat", FURNITURE_ID, (x - 220, x + 190), (y - 170, y - 105), (z - 225, z + 225), color)
    back = _slab("chair back", FURNITURE_ID, (x - 240, x - 190), (y - 60, y + 380), (z - 200, z + 200), color)
    pole = _slab("pole", FURNITURE_ID, (x - 50, x), (_FLOOR_Y_MM, y - 170), (z - 25, z + 25), (0.1, 0.1, 0.1))
    return [seat, back, pole]


def _legs(subject: Subject, rng: np.random.Generator) -> list[Body]:
    """Thighs and shins under the table."""
    color: Color = (0.05, 0.07, 0.15) if rng.random() < 0.6 else (0.08, 0.08, 0.08)
    hips = np.array(HIPS_WORLD_MM)
    bodies = []
    for side in (-1.0, 1.0):
        hip = hips + np.array([0.0, -20.0, side * 85.0])
        knee = hip + np.array([430.0 * subject.scale, -10.0, side * 60.0])
        length = float(np.linalg.norm(knee - hip))
        z = (knee - hip) / length
        x = np.cross(np.array([0.0, 1.0, 0.0]), z)
        x /= np.linalg.norm(x)
        thigh = transforms.rigid(np.stack([x, np.cross(z, x), z], axis=-1), hip)
        bodies.append(Shape.of("thigh", LEGS_ID, tapered_capsule(82.0, 58.0, length), color).moved(thigh))
        down = transforms.rigid(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), knee)
        bodies.append(Shape.of("shin", LEGS_ID, tapered_capsule(56.0, 40.0, 420.0), color).moved(down))
    return bodies


def _walls(rng: np.random.Generator) -> list[Body]:
    """Floor, four walls and some posters and shelves on them."""
    wall = _WALLS[int(rng.integers(len(_WALLS)))]
    stain = Texture("mottle", (0.85 * wall[0], 0.85 * wall[1], 0.85 * wall[2]), 180.0, 0.6, int(rng.integers(1, 1000)))
    tone = float(rng.uniform(0.10, 0.30))
    floor = Texture("checker", (0.8 * tone, 0.8 * tone, 0.8 * tone), 500.0, 0.7)
    low, high = _FLOOR_Y_MM, _FLOOR_Y_MM + 2600.0
    bodies = [
        _slab("floor", ROOM_ID, (-2500, 2900), (low - 50, low), (-2800, 2900), (tone, tone, 0.95 * tone), floor),
        _slab("wall", ROOM_ID, (-2550, -2500), (low, high), (-2800, 2900), wall, stain),
        _slab("wall", ROOM_ID, (2900, 2950), (low, high), (-2800, 2900), wall, stain),
        _slab("wall", ROOM_ID, (-2500, 2900), (low, high), (-2850, -2800), wall, stain),
        _slab("wall", ROOM_ID, (-2500, 2900), (low, high), (2900, 2950), wall, stain),
    ]
    for index in range(9):
        along, width, height = (
            float(rng.uniform(-1900, 1900)),
            float(rng.uniform(250, 700)),
            float(rng.uniform(200, 800)),
        )
        y, depth = float(rng.uniform(-150, 900)), float(rng.choice([15.0, 15.0, 260.0]))
        depth += 2.0 * index  # no two in one plane
        color = _POSTERS[int(rng.integers(len(_POSTERS)))]
        pattern = Texture("mottle", (0.6, 0.6, 0.55), 60.0, 0.8, int(rng.integers(1, 1000)))
        spans = [(along, along + width), (y, y + height)]
        on_wall = int(rng.integers(3))
        if on_wall == 0:
            bodies.append(_slab("poster", ROOM_ID, (-2500, -2500 + depth), spans[1], spans[0], color, pattern))
        elif on_wall == 1:
            bodies.append(_slab("poster", ROOM_ID, spans[0], spans[1], (-2800, -2800 + depth), color, pattern))
        else:
            bodies.append(_slab("poster", ROOM_ID, spans[0], spans[1], (2900 - depth, 2900), color, pattern))
    return bodies


def _slab(
    name: str,
    object_id: int,
    x_mm: tuple[float, float],
    y_mm: tuple[float, float],
    z_mm: tuple[float, float],
    color: Color,
    texture: Texture | None = None,
) -> Body:
    """A box between two corners of the world."""
    spans = (x_mm, y_mm, z_mm)
    size = (x_mm[1] - x_mm[0], y_mm[1] - y_mm[0], z_mm[1] - z_mm[0])
    middle = [0.5 * (low + high) for low, high in spans]
    shape = Shape.of(name, object_id, Box(size, min(3.0, 0.2 * min(size))), color, gloss=0.3, texture=texture)
    return shape.moved(shifted(*middle))
