"""What a round of annotation looks at: a window of each stored crop of a hand, and the root of its volume.

Round 1 takes its boxes from the detected hands, later ones from the joints of the round before; the root is the middle
MCP of the round before (paper, Sec. 3.1 and supplement B). Pictures are cut out only when a network asks for them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Float64

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.hand_crops import Cut, HandKey, StoredHand, StoredView, cut, window_map
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, ROOT

BoxSource = Literal["joints", "detected"]
TRIANGULATED: Final = "2d_triangulation"
"""Source of joints of round 0."""
SMOOTHED: Final = "smoothed"
"""Source of joints that were cleaned up over time."""
TRUE_ROUND: Final = 100
"""The round of joints that are the truth: those made from them are an upper bound, and no annotation."""
_KEY: Final = ("sequence_id", "frame", "hand")
_ALMOST_ALL: Final = 1 - 1e-6


class Box(NamedTuple):
    """A square: middle, integers at pixel centres, and side."""

    center_px: Float[np.ndarray, "2"]
    side_px: float


@dataclass(frozen=True)
class WindowRule:
    """How windows are chosen.

    Attributes:
        gamma: Side of a box over the extent of its joints (paper: 1.5).
        min_joints: With fewer known joints the detected box is taken.
        min_inside: A window of which less lies on the stored crop is not used.
    """

    gamma: float
    min_joints: int
    min_inside: float


@dataclass(frozen=True, eq=False)
class KnownHand:
    """What is known of a hand before a round.

    Attributes:
        key: Its sequence, frame and side.
        round: Which round the joints are of.
        joints_world_mm: NaN where not valid.
        center_world_mm: Where the body says that the hand is; NaN if it does not.
        boxes: Detected ones by view, in rectified pixels.
    """

    key: HandKey
    round: int
    joints_world_mm: Float64[np.ndarray, "joint=21 3"]
    center_world_mm: Float64[np.ndarray, "3"]
    boxes: Mapping[str, Box]

    @property
    def root_world_mm(self) -> Float64[np.ndarray, "3"]:
        """The middle MCP, else the body's centre of the hand; NaN where neither is known."""
        root = self.joints_world_mm[ROOT]
        return root if np.isfinite(root).all() else self.center_world_mm

    @property
    def is_valid(self) -> Bool[np.ndarray, "joint=21"]:
        """Which joints are known."""
        return np.asarray(np.isfinite(self.joints_world_mm).all(axis=-1))

    @property
    def other_key(self) -> HandKey:
        """Return the key of the other hand at this instant."""
        sequence, frame, hand = self.key
        return sequence, frame, HANDS[1 - HANDS.index(hand)]


@dataclass(frozen=True, eq=False)
class HandWindows:
    """Where a round looks at a hand.

    Attributes:
        root_world_mm: Centre of the volume; NaN if unknown.
        is_left: Whether it is a left hand.
        views: Stored crops that are used.
        boxes: Of each, in its pixels.
        is_crop_outside: Whether any window leaves its stored crop.
        box_source: What the boxes are around.
    """

    root_world_mm: Float64[np.ndarray, "3"]
    is_left: bool
    views: tuple[StoredView, ...]
    boxes: tuple[Box, ...]
    is_crop_outside: bool
    box_source: BoxSource

    def cuts(self, size_px: int) -> list[Cut]:
        """Cut the windows out, each with its exact matrix.

        Args:
            size_px: Side of the pictures.
        """
        return [
            cut(view, window_map(box.center_px, box.side_px, size_px), size_px)
            for view, box in zip(self.views, self.boxes, strict=True)
        ]


def known_hands(joints: pa.Table, hand_boxes: pa.Table) -> list[KnownHand]:
    """Return what is known of each hand, in the order of the rows of `catalog.JOINTS`."""
    points = joints_or_nan(joints)
    centers, boxes = _detected(hand_boxes)
    rounds, nowhere = joints["round"].to_pylist(), np.full(3, np.nan)
    return [
        KnownHand(key, rounds[row], points[row], centers.get(key, nowhere), boxes.get(key, {}))
        for row, key in enumerate(_keys(joints))
    ]


def joints_or_nan(joints: pa.Table) -> Float64[np.ndarray, "hand joint=21 3"]:
    """Return the positions of a `catalog.JOINTS` table, NaN where not valid."""
    points = to_numpy(joints["joints_world_mm"]).reshape(-1, NUM_JOINTS, 3).astype(np.float64)
    is_valid = to_numpy(joints["valid"]).reshape(-1, NUM_JOINTS).astype(bool)
    return np.where(is_valid[..., None], points, np.nan)


def hand_windows(
    known: KnownHand,
    stored: StoredHand | None,
    matrices: Mapping[str, Float64[np.ndarray, "3 4"]],
    rule: WindowRule,
) -> HandWindows:
    """Choose the windows through which a round sees a hand.

    Args:
        known: What is known of it.
        stored: Its stored crops, if there are any.
        matrices: P_pixel_from_world of each rectified view.
        rule: How windows are chosen.
    """
    has_joints = known.round > 0 and int(known.is_valid.sum()) >= rule.min_joints
    chosen, is_outside = [], False
    for view in stored.views if stored else ():
        box = _joints_box(view, known, rule.gamma) if has_joints else _detected_box(view, known, matrices)
        inside = 0.0 if box is None else inside_share(box, view.size_px)
        is_outside |= box is not None and inside < _ALMOST_ALL
        if box is not None and inside >= rule.min_inside:
            chosen.append((view, box))
    views, boxes = (tuple(column) for column in zip(*chosen, strict=True)) if chosen else ((), ())
    source: BoxSource = "joints" if has_joints else "detected"
    return HandWindows(known.root_world_mm, known.key[2] == "left", views, boxes, is_outside, source)


def inside_share(box: Box, size_px: tuple[int, int]) -> float:
    """Return the share of a box that lies on a picture of this width and height."""
    center, half = np.asarray(box.center_px, dtype=np.float64), box.side_px / 2
    upper = np.minimum(center + half, np.array(size_px) - 0.5)
    overlap = np.clip(upper - np.maximum(center - half, -0.5), 0.0, None)
    return float(overlap.prod() / box.side_px**2)


def _joints_box(view: StoredView, known: KnownHand, gamma: float) -> Box | None:
    """Return the box around the projected joints in a stored crop; none if the hand is behind the camera."""
    pixels = view.project(known.joints_world_mm[known.is_valid])
    return Box(*square_box(pixels, gamma)) if np.isfinite(pixels).all() else None


def _detected_box(view: StoredView, known: KnownHand, matrices: Mapping[str, Float64[np.ndarray, "3 4"]]) -> Box | None:
    """Return the detected box in pixels of a stored crop.

    Crop and rectified view are pinholes at one place, so that H = (K R) (K' R)^-1 is the map of their pixels; here,
    where they also look the same way, it is a scale and a shift.
    """
    box, P_rectified = known.boxes.get(view.camera_id), matrices.get(view.camera_id)
    if box is None or P_rectified is None:
        return None
    H_crop_from_rectified = view.P_pixel_from_world[:, :3] @ np.linalg.inv(P_rectified[:, :3])
    x, y, depth = H_crop_from_rectified @ np.append(box.center_px, 1.0)
    return Box(np.array([x, y]) / depth, box.side_px * float(H_crop_from_rectified[0, 0] / depth))


def _detected(
    hand_boxes: pa.Table,
) -> tuple[dict[HandKey, Float64[np.ndarray, "3"]], dict[HandKey, dict[str, Box]]]:
    """Return the centre of each hand, where known, and its boxes by view."""
    middles = to_numpy(hand_boxes["hand_center_world_mm"]).astype(np.float64)
    pixels = to_numpy(hand_boxes["center_rectified_px"]).astype(np.float64)
    columns = (hand_boxes[name].to_pylist() for name in ("camera_id", "side_px", "valid"))
    centers: dict[HandKey, Float64[np.ndarray, 3]] = {}
    boxes: dict[HandKey, dict[str, Box]] = {}
    for row, (key, camera_id, side_px, is_valid) in enumerate(zip(_keys(hand_boxes), *columns, strict=True)):
        if np.isfinite(middles[row]).all():
            centers[key] = middles[row]
        if is_valid:
            boxes.setdefault(key, {})[camera_id] = Box(pixels[row], side_px)
    return centers, boxes


def _keys(table: pa.Table) -> list[HandKey]:
    return list(zip(*(table[name].to_pylist() for name in _KEY), strict=True))
