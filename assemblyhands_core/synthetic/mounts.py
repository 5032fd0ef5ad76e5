"""Where a camera is mounted: aimed at a point, then a little off, as every real mount is."""

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.geometry import transforms


def look_at(
    center_mm: Float[np.ndarray, "3"],
    target_mm: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
    roll_rad: float = 0.0,
) -> Float64[np.ndarray, "4 4"]:
    """Return the pose of a camera (or headset) that looks from one point at another.

    Args:
        center_mm: Its centre, in the frame in which it is placed (the world, or the headset's).
        target_mm: What its z axis points at.
        up: Direction that image up leans to, in the same frame.
        roll_rad: Turn of the camera about its axis, clockwise as seen from behind it.

    Returns:
        `T_camera_from_frame`: x right, y down, z forward.

    Raises:
        ValueError: Target and centre coincide, or the view is along `up`, so that no image up follows.
    """
    forward = target_mm - center_mm
    right = np.cross(forward, up)
    if min(np.linalg.norm(forward), np.linalg.norm(right)) < 1e-9:
        raise ValueError(f"No pose looks from {center_mm} at {target_mm} with {up} up: choose another up.")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    down = np.cross(forward, right)
    right = np.cos(roll_rad) * right + np.sin(roll_rad) * down
    rotation = np.stack((right, np.cross(forward, right), forward)).astype(np.float64)
    return transforms.rigid(rotation, -rotation @ center_mm)


def spherical(azimuth_deg: float, elevation_deg: float) -> Float64[np.ndarray, "3"]:
    """Return the unit vector at an azimuth (from +x towards +z) and an elevation (towards +y)."""
    azimuth, elevation = np.radians((azimuth_deg, elevation_deg))
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)], dtype=np.float64
    )


def disturbed(
    T_camera_from_frame: Float64[np.ndarray, "4 4"], max_shift_mm: float, max_turn_deg: float, rng: np.random.Generator
) -> Float64[np.ndarray, "4 4"]:
    """Return a pose whose centre has moved by up to `max_shift_mm` along each axis and which has turned a little.

    The turn is about a random axis, by up to `max_turn_deg`.
    """
    center = transforms.inverse(T_camera_from_frame)[:3, 3] + rng.uniform(-max_shift_mm, max_shift_mm, 3)
    axis = rng.normal(size=3)
    angle = np.radians(rng.uniform(-max_turn_deg, max_turn_deg))
    rotation = _turn(axis / np.linalg.norm(axis), float(angle)) @ T_camera_from_frame[:3, :3]
    return transforms.rigid(rotation, -rotation @ center)


def _turn(axis: Float64[np.ndarray, "3"], angle_rad: float) -> Float64[np.ndarray, "3 3"]:
    """Return the rotation about a unit axis (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross)
