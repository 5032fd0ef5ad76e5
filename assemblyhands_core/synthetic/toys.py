"""The things people work with: a vehicle to assemble with a screwdriver, and what lies on a desk.

Sizes are those of take-apart toys for children (Assembly101 uses such): wheels of 40 mm, thumb screws of 13 mm.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.grips import GripKind
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.motion import rotation, shifted
from assemblyhands_core.synthetic.objects import (
    Color,
    Grip,
    Mount,
    Part,
    PartSet,
    Piece,
    grip_around,
    grip_from_above,
    grip_lying,
    piece,
    pointing,
)
from assemblyhands_core.synthetic.solids import Box, Lathe, cylinder, tapered_capsule

SetKind = Literal["assembly", "desktop"]

PALETTE: Final[tuple[Color, ...]] = (
    (0.62, 0.05, 0.04),
    (0.80, 0.33, 0.03),
    (0.85, 0.62, 0.05),
    (0.10, 0.38, 0.10),
    (0.04, 0.16, 0.50),
    (0.05, 0.38, 0.48),
    (0.30, 0.08, 0.36),
    (0.70, 0.70, 0.66),
)
"""Colours of plastic."""
RUBBER: Final[Color] = (0.025, 0.025, 0.03)
STEEL: Final[Color] = (0.55, 0.55, 0.57)

NOUNS: Final = (
    *("banana", "bottle", "box", "bumper", "cabin", "can", "cap"),
    *("chassis", "mug", "pen", "screw", "screwdriver", "wheel"),
)
"""What parts are called, in all sets."""

_TOYS: Final = {"a": "dump truck", "b": "excavator", "c": "fire truck"}
_AHEAD: Final = (1.0, 0.0, 0.0)
_ROUND: Final = 24
_SCREW_TRAVEL_MM: Final = 6.0


def draw_set(kind: SetKind, rng: np.random.Generator) -> PartSet:
    """Draw the things of one take.

    Args:
        kind: "assembly": a vehicle and a screwdriver; "desktop": a bottle with a cap, a mug and other things.
        rng: Decides on sizes, colours and which parts there are.
    """
    return _draw_vehicle(rng) if kind == "assembly" else _draw_desk(rng)


def _draw_vehicle(rng: np.random.Generator) -> PartSet:
    """Chassis, wheels with a screw each, cabin with a screw, bumper, sometimes a tank, and the screwdriver."""
    colors = [PALETTE[i] for i in rng.permutation(len(PALETTE))]
    size = _Vehicle(
        wheel_radius_mm=float(rng.uniform(18.5, 21.5)),
        wheel_width_mm=float(rng.uniform(15.0, 19.0)),
        cabin_mm=(float(rng.uniform(44, 54)), float(rng.uniform(38, 44)), float(rng.uniform(34, 44))),
        is_round_cabin=bool(rng.random() < 0.35),
    )
    parts = [_chassis(size, colors[0], colors[1])]
    for axle, x_mm in (("front", 48.0), ("rear", -6.0)):
        for side, y in (("left", 1.0), ("right", -1.0)):
            parts += _wheel(f"{axle}_{side}", x_mm, y, size, colors[2])
    parts += _cabin(size, colors[3])
    parts += [_bumper(colors[4]), _screwdriver(colors[5])]
    letter, name = list(_TOYS.items())[int(rng.integers(len(_TOYS)))]
    toy_id = f"{letter}{int(rng.integers(1, 15)):02d}{'abcd'[int(rng.integers(4))]}"
    return PartSet(toy_id, name, "chassis", {part.name: part for part in parts}, tool="screwdriver")


def toy_name(toy_id: str, kind: SetKind) -> str:
    """Return what the toy of a recording is: its letter tells the kind of vehicle (formats 3.1)."""
    return _TOYS[toy_id[0]] if kind == "assembly" else "desktop things"


@dataclass(frozen=True)
class _Vehicle:
    """Sizes that fit one another."""

    wheel_radius_mm: float
    wheel_width_mm: float
    cabin_mm: tuple[float, float, float]
    is_round_cabin: bool


def _chassis(size: _Vehicle, color: Color, second: Color) -> Part:
    feet = [piece(Box((14.0, 40.0, 18.0)), second, (x, 0.0, -17.0)) for x in (48.0, -6.0)]
    hubs = [Piece(cylinder(9.0, 6.0), _side(x, y, 30.0), RUBBER) for x in (48.0, -6.0) for y in (-1.0, 1.0)]
    deck = piece(Box((62.0, 46.0, 10.0)), second, (-48.0, 0.0, 15.0))
    body = piece(Box((170.0, 56.0, 24.0), 4.0), color)
    hold = Grip(GripKind("hold", 56.0), pointing((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (-62.0, 0.0, -1.0)), num_rolls=2)
    return Part("chassis", "chassis", (body, deck, *feet, *hubs), 26.0, hold)


def _wheel(place: str, x_mm: float, y: float, size: _Vehicle, color: Color) -> list[Part]:
    """A wheel on one side of the chassis and the screw that holds it."""
    radius, width = size.wheel_radius_mm, size.wheel_width_mm
    rim = piece(cylinder(0.62 * radius, width + 2.0, 1.5), color)
    tyre = piece(cylinder(radius, width, 3.5, 32), RUBBER)
    wheel = Part(
        f"wheel_{place}",
        "wheel",
        (tyre, rim),
        width / 2 + 1.0,
        grip_from_above("round", 2 * radius, 1.0, 12),
        mount=Mount("chassis", _side(x_mm, y, 34.0 + width / 2), num_turns=12),
        gloss=0.35,
    )
    return [wheel, _screw(f"screw_{place}", wheel.name, shifted(z_mm=width / 2 + 1.0))]


def _side(x_mm: float, y: float, distance_mm: float) -> np.ndarray:
    """The frame on the left (y > 0) or right side of the chassis, z outwards."""
    return pointing((0.0, y, 0.0), _AHEAD, (x_mm, y * distance_mm, -4.0))


def _screw(name: str, parent: str, T_parent_from_screw: np.ndarray) -> Part:
    """A thumb screw; its origin lies below the head."""
    head = piece(cylinder(7.0, 14.0, 1.2, 8), STEEL, (0.0, 0.0, 7.0))
    shank = piece(cylinder(3.0, 18.0, 1.0, 10), STEEL, (0.0, 0.0, -8.0))
    pick = grip_lying("tripod", 13.5, 7.0)
    work = grip_from_above("round", 13.5, 9.5, 12)
    mount = Mount(parent, T_parent_from_screw, _SCREW_TRAVEL_MM, num_turns=1)
    return Part(name, "screw", (head, shank), 7.0, pick, work, True, mount, gloss=0.7, metallic=0.7)


def _cabin(size: _Vehicle, color: Color) -> list[Part]:
    """The driver's cabin, or a round tank, and the screw on its roof."""
    length, width, height = size.cabin_mm
    glass = (0.03, 0.05, 0.07)
    if size.is_round_cabin:
        pieces = [piece(cylinder(width / 2, height, 4.0, 28), color, (0.0, 0.0, height / 2))]
        grip = grip_from_above("round", width, height - 12.0, 12)
    else:
        window = piece(Box((length + 1.0, width - 8.0, 0.32 * height), 1.5), glass, (0.0, 0.0, 0.62 * height))
        pieces = [piece(Box(size.cabin_mm, 4.0), color, (0.0, 0.0, height / 2)), window]
        grip = grip_from_above("tripod", width, height - 12.0, 2)
    turns = 12 if size.is_round_cabin else 1
    mount = Mount("chassis", shifted(42.0, 0.0, 12.0), num_turns=turns)
    cabin = Part("cabin", "cabin", tuple(pieces), 0.0, grip, mount=mount, gloss=0.6)
    return [cabin, _screw("screw_cabin", "cabin", shifted(z_mm=height))]


def _bumper(color: Color) -> Part:
    plate = piece(Box((20.0, 60.0, 12.0), 3.0), color, (0.0, 0.0, 6.0))
    knob = piece(Box((18.0, 26.0, 22.0), 3.0), color, (0.0, 0.0, 17.0))
    mount = Mount("chassis", pointing(_AHEAD, (0.0, 0.0, -1.0), (85.0, 0.0, 0.0)))
    return Part("bumper", "bumper", (plate, knob), 0.0, grip_from_above("pinch", 26.0, 19.0, 2), mount=mount)


def _screwdriver(color: Color) -> Part:
    """A short stout screwdriver; the origin is the tip, z points back to the handle."""
    outline = ((0.0, 58.0), (8.0, 58.0), (11.0, 66.0), (11.0, 78.0), (12.5, 86.0), (12.5, 108.0), (8.0, 116.0))
    handle = piece(Lathe((*outline, (0.0, 116.0)), 12), color)
    shaft = piece(cylinder(3.0, 62.0), STEEL, (0.0, 0.0, 31.0))
    work = Grip(GripKind("round", 22.0), pointing((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 72.0)), num_rolls=12)
    pick = grip_lying("tripod", 22.5, 80.0)
    return Part("screwdriver", "screwdriver", (handle, shaft), 12.5, pick, work, True, gloss=0.6)


def _draw_desk(rng: np.random.Generator) -> PartSet:
    """Bottle with cap, mug with pen, can, carton, banana."""
    colors = [PALETTE[i] for i in rng.permutation(len(PALETTE))]
    parts = [*_bottle(rng, colors[0], colors[1]), *_mug(rng, colors[2], colors[3])]
    parts += [_can(rng, colors[4]), _carton(rng, colors[5]), _banana(rng)]
    return PartSet("d01", "desk", "bottle", {part.name: part for part in parts})


def _bottle(rng: np.random.Generator, color: Color, second: Color) -> list[Part]:
    radius, height = float(rng.uniform(27.0, 33.0)), float(rng.uniform(88.0, 105.0))
    neck = 13.0
    body = [(0.0, 0.0), (radius - 3, 0.0), (radius, 3.0), (radius, height - 22), (neck + 4, height - 4)]
    outline = (*body, (neck, height), (neck, height + 14.0), (0.0, height + 14.0))
    bottle = Part("bottle", "bottle", (piece(Lathe(outline, 32), color),), 0.0, grip_around(2 * radius, 0.4 * height))
    cap_solid = Lathe(((0.0, 0.0), (neck + 4, 0.0), (neck + 4, 17.0), (neck + 2, 19.0), (0.0, 19.0)), 16)
    mount = Mount("bottle", shifted(z_mm=height + 3.0), _SCREW_TRAVEL_MM, num_turns=12)
    grip = grip_from_above("round", 2 * (neck + 4), 11.0, 12)
    return [bottle, Part("cap", "cap", (piece(cap_solid, second),), 0.0, grip, mount=mount)]


def _mug(rng: np.random.Generator, color: Color, second: Color) -> list[Part]:
    radius, height = float(rng.uniform(34.0, 39.0)), float(rng.uniform(80.0, 95.0))
    wall = ((radius, 2.0), (radius, height), (radius - 4, height), (radius - 4, 6.0), (0.0, 6.0))
    cup = piece(Lathe(((0.0, 0.0), (radius - 2, 0.0), *wall), 36), color)
    mug = Part("mug", "mug", (cup,), 0.0, grip_around(2 * radius, 0.5 * height), gloss=0.7)
    shaft = piece(tapered_capsule(2.5, 4.5, 128.0, 10), second, (0.0, 0.0, 3.0))
    work = grip_from_above("tripod", 9.0, 104.0, 12)
    # From the bottom on one side to the rim on the other; walls are 4 mm and the bottom 6 mm thick.
    angle = float(np.arctan2(8.0 + radius - 8.5, height - 6.0))
    leaning = rotation(np.array([angle, 0.0, 0.0]))
    mount = Mount("mug", transforms.rigid(leaning, np.array([0.0, 8.0, 9.0 - 3.0 * np.cos(angle)])))
    return [mug, Part("pen", "pen", (shaft,), 5.0, grip_lying("tripod", 9.0, 92.0), work, True, mount)]


def _can(rng: np.random.Generator, color: Color) -> Part:
    radius, height = float(rng.uniform(30.0, 33.0)), float(rng.uniform(95.0, 115.0))
    outline = (
        (0.0, 3.0),
        (radius - 5, 0.0),
        (radius, 6.0),
        (radius, height - 7),
        (radius - 5, height),
        (0.0, height - 3),
    )
    grip = grip_around(2 * radius, 0.5 * height)
    return Part("can", "can", (piece(Lathe(outline, 32), color),), 0.0, grip, gloss=0.8, metallic=0.5)


def _carton(rng: np.random.Generator, color: Color) -> Part:
    size = (float(rng.uniform(70, 95)), float(rng.uniform(40, 52)), float(rng.uniform(36, 60)))
    texture = Texture("mottle", (0.5, 0.36, 0.2), 20.0, 0.6, int(rng.integers(1, 1000)))
    grip = grip_from_above("hold", size[1], size[2] - 16.0, 2)
    return Part("carton", "box", (piece(Box(size), color, (0.0, 0.0, size[2] / 2)),), 0.0, grip, texture=texture)


def _banana(rng: np.random.Generator) -> Part:
    """Three tapered pieces along a bow, lying on their side."""
    radius = float(rng.uniform(14.0, 17.0))
    pieces = []
    for lean, y, z in ((0.35, 15.0, -63.0), (0.0, 0.0, -22.0), (-0.35, 0.0, 22.0)):
        bow = transforms.rigid(rotation(np.array([lean, 0.0, 0.0])), np.array([0.0, y, z]))
        ends = (radius * 0.55, radius) if lean > 0 else (radius, radius * 0.55) if lean < 0 else (radius, radius)
        pieces.append(Piece(tapered_capsule(*ends, 44.0, 16), bow, (0.80, 0.58, 0.06)))
    grip = grip_lying("tripod", 2 * radius, 0.0)
    return Part("banana", "banana", tuple(pieces), radius, grip, is_lying=True, gloss=0.3)
