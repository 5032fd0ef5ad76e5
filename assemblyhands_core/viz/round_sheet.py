"""Crops by round (paper, Fig. 4): where each round of annotation looked at a hand, and the joints that it found there.

A row is a hand at one instant in one view: first its stored crop as it is, then, for each round, the same crop with the
window that the round looked through (yellow square) and the joints that it found. The truth is not drawn.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.data.hand_crops import Cut, HandKey, StoredHand, StoredView, cut, window_map
from assemblyhands_core.data.round_outcomes import CONVERGED, NO_ROOT, TOO_FEW_VIEWS, displacement_mm
from assemblyhands_core.data.rounds import Box, KnownHand, WindowRule, hand_windows
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.viz.overlays import Image, contact_sheet, draw_box, draw_hand

TILE_PX: Final = 400
_MARGIN: Final = 1.06  # of the crop: a window as large as the crop is still seen whole
_DID_NOT_LOOK: Final = frozenset({CONVERGED, TOO_FEW_VIEWS, NO_ROOT})

Joints = Float[np.ndarray, "joint=21 3"]
Pixels = Float64[np.ndarray, "joint=21 2"]


class HandRound(NamedTuple):
    """What a round made of a hand.

    Attributes:
        known: The hand after it.
        kept_round: Whose joints these are.
        reason: Why they are not its own, or why there are none; empty otherwise.
    """

    known: KnownHand
    kept_round: int
    reason: str


class Look(NamedTuple):
    """A tile of the sheet.

    Attributes:
        caption: Which round, and what became of the hand in it.
        box: The window that it looked through, in pixels of the stored crop; none drawn if it was all of the crop.
        joints_px: Found, in pixels of the stored crop; NaN where missing.
    """

    caption: str
    box: Box | None
    joints_px: Pixels


@dataclass(frozen=True, eq=False)
class HandCourse:
    """A row of the sheet: a hand from round to round."""

    key: HandKey
    view: StoredView
    looks: tuple[Look, ...]


def choose_hands(keys: Sequence[HandKey], moved_mm: Float[np.ndarray, " hand"], count: int) -> list[int]:
    """Choose the hand that moved farthest in each of `count` stretches of all instants, each as long as the others.

    Args:
        keys: Of the hands, in any order.
        moved_mm: How far each moved from the first round to the last; NaN if unknown.
        count: How many to choose; fewer where stretches have no hand that is known.

    Returns:
        Their positions, by time.
    """
    instants = sorted({key[:2] for key in keys})
    place = {instant: number * count // len(instants) for number, instant in enumerate(instants)}
    best: dict[int, int] = {}
    for index, key in enumerate(keys):
        rival = best.get(place[key[:2]])
        if np.isfinite(moved_mm[index]) and (rival is None or moved_mm[index] > moved_mm[rival]):
            best[place[key[:2]]] = index
    return [best[stretch] for stretch in sorted(best)]


def follow_hand(
    rounds: Sequence[HandRound],
    stored: StoredHand,
    matrices: Mapping[str, Float64[np.ndarray, "3 4"]],
    rule: WindowRule,
) -> HandCourse:
    """Return a hand's row: what each round looked through, in the view that shows best what it did.

    Args:
        rounds: Round 0 and all that follow.
        stored: Its stored crops, at least one.
        matrices: P_pixel_from_world of each rectified view.
        rule: How the rounds chose their windows.
    """
    view = _best_view(stored.views, rounds[0].known.joints_world_mm, rounds[-1].known.joints_world_mm)
    looks = [Look(_name(0), None, view.project(rounds[0].known.joints_world_mm))]
    for before, now in itertools.pairwise(rounds):
        windows = hand_windows(before.known, stored, matrices, rule)
        boxes = dict(zip((seen.camera_id for seen in windows.views), windows.boxes, strict=True))
        box = None if now.reason in _DID_NOT_LOOK else boxes.get(view.camera_id)
        looks.append(Look(_caption(before, now), box, view.project(now.known.joints_world_mm)))
    return HandCourse(stored.key, view, tuple(looks))


def draw_sheet(courses: Sequence[HandCourse], recordings: str, tile_px: int = TILE_PX) -> Image:
    """Draw the rows below one another, each under a line that says what it is.

    Args:
        courses: Of hands that went through the same number of rounds.
        recordings: What they are of: "synthetic recordings".
        tile_px: Side of a tile.

    Raises:
        ValueError: There are no rows.
    """
    rows = [draw_strip(course, tile_px) for course in courses]
    return contact_sheet(rows, 1, [_title(course, recordings) for course in courses])


def draw_strip(course: HandCourse, tile_px: int = TILE_PX) -> Image:
    """Draw one row: the stored crop, then what each round made of it."""
    width, height = course.view.size_px
    whole = window_map(np.array([width - 1, height - 1]) / 2, _MARGIN * max(width, height), tile_px)
    plain = cut(course.view, whole, tile_px)
    tiles = [plain.image, *(_draw_look(plain, look, course) for look in course.looks)]
    return contact_sheet(tiles, len(tiles), ["stored crop", *(look.caption for look in course.looks)])


def save_sheet(sheet: Image, path: Path) -> None:
    """Write a sheet as PNG."""
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1].tobytes())


def _draw_look(plain: Cut, look: Look, course: HandCourse) -> Image:
    image = plain.image
    if look.box is not None:
        image = draw_box(image, _moved(_corners(look.box), plain))
    joints_px = _moved(look.joints_px, plain)
    return draw_hand(image, joints_px, np.isfinite(joints_px).all(axis=-1), course.key[2])


def _moved(pixels: Float[np.ndarray, "point 2"], plain: Cut) -> Float64[np.ndarray, "point 2"]:
    """Return pixels of the stored crop as pixels of a tile."""
    A = plain.A_cut_from_stored
    return np.asarray(pixels @ A[:2, :2].T + A[:2, 2])


def _corners(box: Box) -> Float64[np.ndarray, "corner=4 2"]:
    return box.center_px + box.side_px / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _best_view(views: Sequence[StoredView], first_mm: Joints, last_mm: Joints) -> StoredView:
    """Return the view that has most of the last joints on its crop; of equal ones that in which they moved farthest."""

    def rank(view: StoredView) -> tuple[int, float]:
        before_px, after_px = view.project(first_mm), view.project(last_mm)
        inside = (after_px >= -0.5) & (after_px <= np.array(view.size_px) - 0.5)
        moved_px = np.linalg.norm(after_px - before_px, axis=-1)
        return int(inside.all(axis=-1).sum()), float(moved_px[np.isfinite(moved_px)].sum())

    return max(views, key=rank)


def _caption(before: HandRound, now: HandRound) -> str:
    number = now.known.round
    if now.reason:
        kept = f" keeps {_name(now.kept_round)}" if now.kept_round < number else ""
        return f"R{number}{kept}: {now.reason.replace('_', ' ')}"
    moved_mm = displacement_mm(now.known.joints_world_mm[None], before.known.joints_world_mm[None])[0]
    num_found = int(now.known.is_valid.sum())
    found = "" if num_found == NUM_JOINTS else f", {num_found} joints"
    return f"R{number}: moved {moved_mm:.1f} mm{found}" if np.isfinite(moved_mm) else f"R{number}{found}"


def _name(number: int) -> str:
    return f"R{number}" if number else "2D + triangulation"


def _title(course: HandCourse, recordings: str) -> str:
    sequence, frame, hand = course.key
    return f"{recordings}: {sequence}, frame {frame}, {hand} hand, {course.view.camera_id}"
