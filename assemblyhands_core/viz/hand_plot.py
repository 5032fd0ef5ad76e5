"""Hands in a 3D plot of matplotlib, seen from a camera: no direction of the world is up in every recording.

The axes are right, away from the camera, and up in its picture, in mm. Right hands are solid with round joints, left
ones dashed with square joints, as in the overlays.
"""

from typing import Any, Final

import numpy as np
from jaxtyping import Float

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import BONES, WRIST, Hand
from assemblyhands_core.viz.overlays import FINGER_COLORS

_WRIST_COLOR: Final = "#777777"
_MARGIN: Final = 1.1
_AXES: Final = ("right (mm)", "away (mm)", "up (mm)")


def plot_hand(
    axes: Any,
    joints_world_mm: Float[np.ndarray, "joint=21 3"],
    hand: Hand,
    camera: Camera,
    color: str | None = None,
    label: str | None = None,
) -> None:
    """Draw a hand's bones and joints.

    Args:
        axes: Of a 3D plot.
        joints_world_mm: NaN where missing; bones need both their ends.
        hand: Which one.
        camera: From which it is seen.
        color: Of everything; by finger without one.
        label: For the legend.
    """
    points = seen_from(camera, joints_world_mm)
    for child, parent in BONES:
        style = "-" if hand == "right" else "--"
        axes.plot(*points[[child, parent]].T, style, color=color or _joint_color(child), lw=1.8)
    is_known = np.isfinite(points).all(axis=-1)
    colors = [color or _joint_color(joint) for joint in np.flatnonzero(is_known).tolist()]
    axes.scatter(*points[is_known].T, c=colors, marker="o" if hand == "right" else "s", s=12, label=label)


def frame_hands(axes: Any, points_world_mm: Float[np.ndarray, "point 3"], camera: Camera) -> None:
    """Give the axes their names and the same scale, around all that is drawn; points that are NaN do not count."""
    points = seen_from(camera, points_world_mm)
    points = points[np.isfinite(points).all(axis=-1)]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (-np.ones(3), np.ones(3))
    half, middle = _MARGIN * (high - low).max() / 2, (low + high) / 2
    for name, label, value in zip("xyz", _AXES, middle, strict=True):
        getattr(axes, f"set_{name}lim")(value - half, value + half)
        getattr(axes, f"set_{name}label")(label)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=15, azim=-75)


def seen_from(camera: Camera, points_world_mm: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    """Return points as right, away and up in a camera's picture, mm from the camera."""
    x, y, z = np.moveaxis(camera.to_camera(points_world_mm), -1, 0)
    return np.stack([x, z, -y], axis=-1)


def _joint_color(joint: int) -> str:
    return _WRIST_COLOR if joint == WRIST else "#{:02X}{:02X}{:02X}".format(*FINGER_COLORS[joint // 4])
