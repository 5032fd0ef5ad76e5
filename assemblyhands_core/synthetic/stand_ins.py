"""2D keypoints that stand in for a detector's: the true ones with noise.

They are **made from the truth** and no detector's work: they let the pipeline be tried before there are detectors for
synthetic pictures, and say nothing about how good these would be. Visible joints are off by a few per cent of the
hand's size, hidden ones by more, some of them grossly; confidence tells which, though not exactly.
"""

import zlib
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.names import ego_serial
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.body_keypoints import body_keypoints_mm
from assemblyhands_core.synthetic.session import Shot

VISIBLE_NOISE: Final = 0.02
"""Standard deviation of a visible joint, as a share of the longer side of the hand's box."""
HIDDEN_NOISE: Final = 0.06
GROSS_CHANCE: Final = 0.12
"""How often a hidden joint is grossly wrong: anywhere in the hand's box."""
BODY_NOISE_PX: Final = 5.0
MIN_JOINTS: Final = 6
"""A hand of which fewer joints are in the picture is not found."""

_HAND_STREAM, _BODY_STREAM = 0x4A4D, 0xB0D1


def stand_in_hands(sequence_id: str, shot: Shot) -> Iterator[dict[str, Any]]:
    """Yield rows of `studio_tables.STAND_IN_HANDS`: every hand that a fixed camera has in its picture."""
    for name, camera in _fixed(shot).items():
        rng = _rng(sequence_id, shot, name, _HAND_STREAM)
        pixels = camera.project(shot.truth.joints_world_mm)
        is_in_image = camera.contains(pixels)
        for index, hand in enumerate(HANDS):
            found, confidence = _disturbed(pixels[index], shot.truth.is_unoccluded[name][index], rng)
            if is_in_image[index].sum() >= MIN_JOINTS:
                yield {
                    "sequence_id": sequence_id,
                    "camera": name,
                    "frame": shot.truth.frame,
                    "hand": hand,
                    "keypoints_px": found.ravel(),
                    "confidence": np.where(is_in_image[index], confidence, 0.0),
                }


def stand_in_bodies(sequence_id: str, shot: Shot) -> Iterator[dict[str, Any]]:
    """Yield rows of `studio_tables.STAND_IN_BODIES`: the person as every fixed camera has it, without the legs."""
    points = body_keypoints_mm(shot.state)
    known = np.isfinite(points).all(axis=-1)
    for name, camera in _fixed(shot).items():
        rng = _rng(sequence_id, shot, name, _BODY_STREAM)
        pixels = camera.project(np.where(known[:, None], points, 0.0))
        is_found = known & camera.contains(pixels)
        found = np.where(is_found[:, None], pixels + rng.normal(scale=BODY_NOISE_PX, size=pixels.shape), 0.0)
        yield {
            "sequence_id": sequence_id,
            "camera": name,
            "frame": shot.truth.frame,
            "person": 0,
            "keypoints_px": found.ravel(),
            "confidence": np.where(is_found, rng.uniform(0.7, 0.95, len(points)), 0.0),
        }


def _disturbed(
    pixels: Float64[np.ndarray, "joint=21 2"], is_unoccluded: Any, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "joint=21 2"], Float64[np.ndarray, "joint=21"]]:
    """Return pixels with noise, and confidence."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    side = float((high - low).max())
    noise = np.where(is_unoccluded, VISIBLE_NOISE, HIDDEN_NOISE) * side
    found = pixels + rng.normal(size=pixels.shape) * noise[:, None]
    is_gross = ~is_unoccluded & (rng.random(len(pixels)) < GROSS_CHANCE)
    found = np.where(is_gross[:, None], rng.uniform(low, high, pixels.shape), found)
    confidence = np.where(is_unoccluded, rng.uniform(0.6, 0.95, len(pixels)), rng.uniform(0.25, 0.7, len(pixels)))
    return found, confidence


def _fixed(shot: Shot) -> dict[str, Camera]:
    return {name: camera for name, camera in shot.truth.cameras.items() if ego_serial(name) is None}


def _rng(sequence_id: str, shot: Shot, camera_id: str, stream: int) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(f"{sequence_id}/{camera_id}".encode()), shot.truth.frame, stream])
