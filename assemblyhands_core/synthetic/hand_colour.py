"""The colour of a hand's skin: tone of the subject, paler palm, redder joints and tips, creases and nails."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.hands.kinematics import HandSkeleton
from assemblyhands_core.synthetic.hand_field import template_frames
from assemblyhands_core.synthetic.hand_weights import finger_shares, smooth_step

# sRGB of the back of hands from very light to very dark (after the Monk and Fitzpatrick scales).
_TONES_SRGB: Final = (
    (240, 208, 188),
    (226, 184, 158),
    (206, 157, 126),
    (178, 125, 92),
    (141, 93, 65),
    (103, 66, 46),
    (70, 45, 34),
)
_PALM_CREASES_MM: Final = (
    ((36, 66), (22, 68), (8, 74), (-8, 86)),  # heart line
    ((-31, 70), (-14, 64), (6, 56), (26, 42)),  # head line
    ((-31, 72), (-20, 66), (-9, 52), (-4, 38), (-4, 20)),  # life line
)
_CREASE_WIDTH_MM: Final = 1.7


@dataclass(frozen=True, eq=False)
class SkinMarks:
    """Where the template's skin differs in colour, each from 0 to 1 per vertex."""

    palm: Float64[np.ndarray, " vertex"]
    flush: Float64[np.ndarray, " vertex"]
    crease: Float64[np.ndarray, " vertex"]
    nail: Float64[np.ndarray, " vertex"]
    lunula: Float64[np.ndarray, " vertex"]


@dataclass(frozen=True)
class SkinTone:
    """What distinguishes one subject's skin.

    Attributes:
        darkness: 0 (very light) to 1 (very dark).
        redness: Factor on the blood that shows, about 1.
        mottle_seed: Seed of the fine irregularity.
    """

    darkness: float
    redness: float
    mottle_seed: int


def skin_marks(vertices_mm: Float64[np.ndarray, "vertex 3"], normals: Float64[np.ndarray, "vertex 3"]) -> SkinMarks:
    """Find palm, joints, creases and nails on the template's skin, given its outward normals."""
    palm = smooth_step(-normals[:, 2], -0.25, 0.45) * smooth_step(vertices_mm[:, 1], -25.0, 5.0)
    flush, crease = np.zeros(len(vertices_mm)), _palm_creases(vertices_mm) * palm
    nail, lunula = np.zeros(len(vertices_mm)), np.zeros(len(vertices_mm))
    shares, frames = finger_shares(vertices_mm), template_frames()
    for finger in range(5):
        own = smooth_step(shares[:, finger], 0.45, 0.75)
        flush += own * _flush(vertices_mm, normals, finger, frames[finger])
        crease += own * _finger_creases(vertices_mm, normals, finger, frames[finger])
        plate, moon = _nail(vertices_mm, normals, finger, frames[finger, 6])
        nail, lunula = nail + own * plate, lunula + own * moon
    return SkinMarks(palm, *(np.clip(mark, 0.0, 1.0) for mark in (flush, crease * (1 - nail), nail, lunula)))


def skin_albedo(
    vertices_mm: Float64[np.ndarray, "vertex 3"], marks: SkinMarks, tone: SkinTone
) -> Float64[np.ndarray, "vertex 3"]:
    """Return the linear RGB albedo of every vertex, 0 to 1."""
    back = _tone(tone.darkness)
    # Palms hold little melanin: those of dark hands are much paler than the back.
    palm = 0.35 * back + 0.65 * _tone(0.52 * tone.darkness) * (1.04, 0.94, 0.90)
    colour = back + marks.palm[:, None] * (palm - back)
    blood = tone.redness * marks.flush[:, None] * np.array([0.04, 0.26, 0.24])
    colour = colour * (1.0 - blood) * (1.0 + 0.05 * _mottle(vertices_mm, tone.mottle_seed)[:, None])
    colour = colour * (1.0 - marks.crease[:, None] * np.array([0.30, 0.42, 0.44]))
    plate = 0.72 * _tone(0.72 * tone.darkness) * (1.05, 0.84, 0.84) + 0.28 * np.array([0.80, 0.55, 0.50])
    colour = colour + marks.nail[:, None] * (plate - colour)
    colour = colour + marks.lunula[:, None] * 0.3 * (np.array([0.80, 0.68, 0.62]) - colour)
    return np.asarray(np.clip(colour, 0.0, 1.0))


def _tone(darkness: float) -> Float64[np.ndarray, "3"]:
    """Linear RGB on the scale of tones."""
    srgb = np.array(_TONES_SRGB) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    places = np.linspace(0.0, 1.0, len(linear))
    return np.stack([np.interp(darkness, places, linear[:, channel]) for channel in range(3)])


def _mottle(vertices_mm: Float64[np.ndarray, "vertex 3"], seed: int) -> Float64[np.ndarray, " vertex"]:
    """Band-limited noise of about unit size: a sum of plane waves of 6 to 40 mm."""
    generator = np.random.default_rng(seed)
    direction = generator.normal(size=(24, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    waves = direction * (2.0 * np.pi / generator.uniform(6.0, 40.0, size=(24, 1)))
    return np.asarray(np.sin(vertices_mm @ waves.T + generator.uniform(0.0, 2.0 * np.pi, 24)).sum(axis=1) / np.sqrt(12))


def _flush(
    vertices_mm: Float64[np.ndarray, "vertex 3"],
    normals: Float64[np.ndarray, "vertex 3"],
    finger: int,
    frames: Float64[np.ndarray, "7 4 4"],
) -> Float64[np.ndarray, " vertex"]:
    """Red of knuckles and fingertips."""
    flush = np.zeros(len(vertices_mm))
    for slot, size in ((1, 9.0), (3, 7.0), (5, 5.0)):
        offset = vertices_mm - frames[slot, :3, 3]
        dorsal = np.clip(normals @ frames[slot, :3, 2], 0.0, 1.0)
        flush += 0.8 * dorsal * np.exp(-(((offset @ frames[slot, :3, 1]) / size) ** 2))
    tip = (vertices_mm - frames[6, :3, 3]) @ frames[6, :3, 1]
    length = float(HandSkeleton.average().phalanges_mm[finger, 2])
    return np.asarray(flush + 0.9 * smooth_step(tip, 0.3 * length, length))


def _finger_creases(
    vertices_mm: Float64[np.ndarray, "vertex 3"],
    normals: Float64[np.ndarray, "vertex 3"],
    finger: int,
    frames: Float64[np.ndarray, "7 4 4"],
) -> Float64[np.ndarray, " vertex"]:
    """Lines across the joints: sharp on the palm's side, wrinkles on the back of the middle joint."""
    crease = np.zeros(len(vertices_mm))
    root = 0.48 * float(HandSkeleton.average().phalanges_mm[finger, 0])
    lines = [(3, -1.5, -1.0, 1.0), (3, 1.5, -1.0, 0.6), (5, 0.0, -1.0, 0.9), (3, -2.2, 1.0, 0.6), (3, 2.2, 1.0, 0.6)]
    if finger > 0:
        lines.append((2, root, -1.0, 1.0))
    for slot, place, side, strength in lines:
        along = (vertices_mm - frames[slot, :3, 3]) @ frames[slot, :3, 1] - place
        facing = smooth_step(side * (normals @ frames[slot, :3, 2]), 0.0, 0.5)
        crease += strength * facing * np.exp(-((along / _CREASE_WIDTH_MM) ** 2))
    return crease


def _palm_creases(vertices_mm: Float64[np.ndarray, "vertex 3"]) -> Float64[np.ndarray, " vertex"]:
    crease = np.zeros(len(vertices_mm))
    plane = vertices_mm[:, :2]
    for line in _PALM_CREASES_MM:
        for a, b in pairwise(line):
            start, axis = np.array(a), np.subtract(b, a)
            share = np.clip((plane - start) @ axis / (axis @ axis), 0.0, 1.0)
            distance = np.linalg.norm(plane - start - share[:, None] * axis, axis=1)
            crease = np.maximum(crease, np.exp(-((distance / _CREASE_WIDTH_MM) ** 2)))
    return crease


def _nail(
    vertices_mm: Float64[np.ndarray, "vertex 3"],
    normals: Float64[np.ndarray, "vertex 3"],
    finger: int,
    frame: Float64[np.ndarray, "4 4"],
) -> tuple[Float64[np.ndarray, " vertex"], Float64[np.ndarray, " vertex"]]:
    """The nail's plate and its pale moon at the root: a rounded rectangle on the back of the last bone."""
    length = float(HandSkeleton.average().phalanges_mm[finger, 2])
    half_width, half_length = (6.6, 7.2) if finger == 0 else (5.2, 6.0) if finger < 4 else (4.3, 5.2)
    local = (vertices_mm - frame[:3, 3]) @ frame[:3, :3]
    middle = length - 0.2 * half_length
    u, v = local[:, 0] / half_width, (local[:, 1] - middle) / half_length
    facing = smooth_step(normals @ frame[:3, 2], 0.0, 0.35)
    plate = facing * smooth_step(u**4 + v**4, 1.5, 0.7)
    moon = plate * smooth_step(u**2 + ((v + 1.0) / 0.6) ** 2, 1.1, 0.5)
    return np.asarray(plate), np.asarray(moon)
