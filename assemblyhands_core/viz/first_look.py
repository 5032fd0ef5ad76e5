"""From where one looks at a recording first: the right way up, from the cameras' side, near the hands.

Guesses for the eye alone: nothing is computed from them, as no direction of the world is up in every recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from assemblyhands_core.geometry.cameras import Camera

_EYE_DISTANCE_MM: Final = 500.0


@dataclass(frozen=True, eq=False)
class Look:
    """From where one looks at the world, at what, and which way is up."""

    eye_world_mm: Float[np.ndarray, "3"]
    target_world_mm: Float[np.ndarray, "3"]
    up_world: Float[np.ndarray, "3"]


def look_at_hands(points: Float[np.ndarray, "point 3"], cameras: Sequence[Camera], up: str) -> Look | None:
    """Return a look at the hands from the side on which most cameras are; None without hands or cameras.

    Args:
        points: Joints in the world, mm; NaN where missing.
        cameras: The fixed ones.
        up: Of `up_axis`.
    """
    known = points[np.isfinite(points).all(axis=-1)]
    if not len(known) or not cameras:
        return None
    target = np.median(known, axis=0)
    side = np.mean([camera.center_world_mm for camera in cameras], axis=0) - target
    eye = target + _EYE_DISTANCE_MM * side / max(float(np.linalg.norm(side)), 1.0)
    return Look(eye, target, np.eye(3)["xyz".index(up[1])] * (1.0 if up[0] == "+" else -1.0))


def up_axis(cameras: Sequence[Camera]) -> str:
    """Return the world's axis that is up for most cameras, which people rarely mount upside down.

    Returns:
        One of ``+x -x +y -y +z -z``; ``+z`` without cameras.
    """
    if not cameras:
        return "+z"
    up = -np.mean([camera.T_camera_from_world[1, :3] for camera in cameras], axis=0)
    axis = int(np.argmax(np.abs(up)))
    return ("+" if up[axis] > 0 else "-") + "xyz"[axis]
