"""Skeletons drawn over pictures, and sheets of such pictures.

The colours are those of Okabe and Ito, which people with any colour vision can tell apart. Right and left differ by
form too: right bones are solid with round joints, left bones dashed with square joints. Nothing here is random.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from assemblyhands_core.hands.body import BODY_BONES, BODY_KEYPOINT_NAMES
from assemblyhands_core.hands.joints import BONES, HANDS, WRIST, Hand

Image = UInt8[np.ndarray, "height width 3"]  # RGB
Tile = UInt8[np.ndarray, "_height _width 3"]  # RGB, of any size
Point = Float[np.ndarray, "2"]
Color = tuple[int, int, int]

# Thumb, index, middle, ring, pinky (RGB).
FINGER_COLORS: Final[tuple[Color, ...]] = ((213, 94, 0), (230, 159, 0), (0, 158, 115), (86, 180, 233), (204, 121, 167))
HAND_COLORS: Final[dict[Hand, Color]] = {"right": (213, 94, 0), "left": (0, 114, 178)}
_TRUNK_COLOR: Final[Color] = (240, 228, 66)
_WRIST_COLOR: Final[Color] = (255, 255, 255)
_OUTLINE: Final[Color] = (0, 0, 0)

_SHIFT: Final = 4  # OpenCV draws at sixteenths of a pixel
_DASHES: Final = 7  # parts of a dashed bone, every other one drawn
_CAPTION_SHARE: Final = 0.09
_MIN_CAPTION_PX: Final = 16


def draw_hand(
    image: Image, keypoints_px: Float[np.ndarray, "joint=21 2"], valid: Bool[np.ndarray, "joint=21"], hand: Hand
) -> Image:
    """Draw one hand's bones and joints.

    Args:
        image: not changed.
        keypoints_px: AssemblyHands order, pixels.
        valid: which joints to draw; a bone needs both its ends.
        hand: right is drawn solid, left dashed.

    Returns:
        A new picture.
    """
    canvas = np.ascontiguousarray(image).copy()
    width = line_width_px(canvas)
    drawn = valid & np.isfinite(keypoints_px).all(axis=-1)
    for child, parent in BONES:
        if drawn[child] and drawn[parent]:
            _bone(canvas, keypoints_px[child], keypoints_px[parent], FINGER_COLORS[child // 4], width, hand)
    for joint in np.flatnonzero(drawn):
        color = _WRIST_COLOR if joint == WRIST else FINGER_COLORS[joint // 4]
        _joint(canvas, keypoints_px[joint], color, width, hand)
    return canvas


def draw_body(
    image: Image, keypoints_px: Float[np.ndarray, "keypoint=17 2"], valid: Bool[np.ndarray, "keypoint=17"]
) -> Image:
    """Draw a body: right limbs solid, left limbs dashed.

    Args:
        image: not changed.
        keypoints_px: COCO-17 order, pixels.
        valid: which keypoints to draw.

    Returns:
        A new picture.
    """
    canvas = np.ascontiguousarray(image).copy()
    width = line_width_px(canvas)
    drawn = valid & np.isfinite(keypoints_px).all(axis=-1)
    for a, b in BODY_BONES:
        if drawn[a] and drawn[b]:
            sides = {_side(a), _side(b)}
            side = sides.pop() if len(sides) == 1 else None
            _bone(canvas, keypoints_px[a], keypoints_px[b], _side_color(side), width, side)
    for keypoint in np.flatnonzero(drawn):
        side = _side(int(keypoint))
        _joint(canvas, keypoints_px[keypoint], _side_color(side), width, side)
    return canvas


def draw_box(image: Image, corners_px: Float[np.ndarray, "corner=4 2"], hand: Hand | None = None) -> Image:
    """Draw a closed outline, a hand's in its colour and form.

    Args:
        image: not changed.
        corners_px: in order around the box (a rectified square is no square in the raw picture).
        hand: whose box it is.

    Returns:
        A new picture; unchanged where a corner is not finite.
    """
    canvas = np.ascontiguousarray(image).copy()
    if np.isfinite(corners_px).all():
        for start, end in zip(corners_px, np.roll(corners_px, -1, axis=0), strict=True):
            _bone(canvas, start, end, _side_color(hand), line_width_px(canvas), hand)
    return canvas


def line_width_px(image: Image) -> int:
    """Return the width of lines for a picture: 1 px per 250 px of its shorter side, at least 2."""
    return max(2, round(min(int(image.shape[0]), int(image.shape[1])) / 250))


def contact_sheet(tiles: Sequence[Tile], columns: int, captions: Sequence[str]) -> Image:
    """Put pictures side by side, each under its caption.

    Args:
        tiles: pictures; each is fitted into the size of the largest, keeping its shape.
        columns: how many stand in a row.
        captions: one per tile, of one line or several; a line is cut off where it does not fit.

    Returns:
        The rows of captions and tiles; places without a tile are black.

    Raises:
        ValueError: there are no tiles, as many captions as tiles are not given, or ``columns`` is not positive.
    """
    if not tiles or columns < 1 or len(captions) != len(tiles):
        raise ValueError(
            f"A contact sheet needs tiles, a caption for each and at least one column, "
            f"got {len(tiles)} tiles, {len(captions)} captions and {columns} columns."
        )
    height, width = max(tile.shape[0] for tile in tiles), max(tile.shape[1] for tile in tiles)
    caption_px = max(_MIN_CAPTION_PX, round(_CAPTION_SHARE * min(height, width)))
    num_lines = max(text.count("\n") + 1 for text in captions)
    cells = [
        np.concatenate([*_caption(text, num_lines, width, caption_px), _fitted(tile, height, width)])
        for tile, text in zip(tiles, captions, strict=True)
    ]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    return np.concatenate([np.concatenate(cells[i : i + columns], axis=1) for i in range(0, len(cells), columns)])


def _bone(canvas: Image, start: Point, end: Point, color: Color, width: int, side: Hand | None) -> None:
    """Draw a line over a dark rim; dashed for the left side."""
    ends = np.linspace(start, end, _DASHES + 1 if side == "left" else 2)
    pieces = list(zip(ends[:-1:2], ends[1::2], strict=True))
    for ink, thickness in ((_OUTLINE, width + 2), (color, width)):
        for a, b in pieces:
            cv2.line(canvas, _fixed(a), _fixed(b), ink, thickness, cv2.LINE_AA, _SHIFT)


def _joint(canvas: Image, point: Point, color: Color, width: int, side: Hand | None) -> None:
    """Draw a disc over a dark rim; a square for the left side."""
    for ink, radius in ((_OUTLINE, 1.5 * width + 1), (color, 1.5 * width)):
        if side == "left":
            cv2.rectangle(canvas, _fixed(point - radius), _fixed(point + radius), ink, cv2.FILLED, cv2.LINE_AA, _SHIFT)
        else:
            cv2.circle(canvas, _fixed(point), round(radius * (1 << _SHIFT)), ink, cv2.FILLED, cv2.LINE_AA, _SHIFT)


def _fixed(point: Point) -> tuple[int, int]:
    """Return a point in OpenCV's fixed-point pixels; far outside any picture it is clipped, else OpenCV overflows."""
    x, y = np.clip(np.round(np.asarray(point, dtype=np.float64) * (1 << _SHIFT)), -(2**24), 2**24).astype(int).tolist()
    return x, y


def _side(keypoint: int) -> Hand | None:
    return next((hand for hand in HANDS if BODY_KEYPOINT_NAMES[keypoint].startswith(hand)), None)


def _side_color(side: Hand | None) -> Color:
    return HAND_COLORS[side] if side else _TRUNK_COLOR


def _fitted(tile: Tile, height: int, width: int) -> UInt8[np.ndarray, "{height} {width} 3"]:
    """Return the tile scaled to fit, centred on black."""
    scale = min(height / tile.shape[0], width / tile.shape[1])
    size = (max(1, round(tile.shape[1] * scale)), max(1, round(tile.shape[0] * scale)))
    scaled = (
        tile if scale == 1 else cv2.resize(tile, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    )
    cell = np.zeros((height, width, 3), dtype=np.uint8)
    top, left = (height - scaled.shape[0]) // 2, (width - scaled.shape[1]) // 2
    cell[top : top + scaled.shape[0], left : left + scaled.shape[1]] = scaled
    return cell


def _caption(text: str, num_lines: int, width: int, height: int) -> Iterator[UInt8[np.ndarray, "{height} {width} 3"]]:
    """Yield a strip for each line of a caption, and black ones until there are so many."""
    lines = text.split("\n")
    for line in [*lines, *[""] * (num_lines - len(lines))]:
        yield _strip(line, width, height)


def _strip(text: str, width: int, height: int) -> UInt8[np.ndarray, "{height} {width} 3"]:
    """Return a black strip with white text, made smaller down to half its size before it is cut off."""
    strip = np.zeros((height, width, 3), dtype=np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    scale = 0.55 * height / cv2.getTextSize("X", font, 1.0, 1)[0][1]
    room = width - height // 2
    wide = cv2.getTextSize(text, font, scale, 1)[0][0]
    scale *= min(1.0, max(0.5, room / max(wide, 1)))
    while text and cv2.getTextSize(text, font, scale, 1)[0][0] > room:
        text = text[:-1]
    origin = (height // 4, round(0.76 * height))
    cv2.putText(strip, text, origin, font, scale, (255, 255, 255), max(1, height // 20), cv2.LINE_AA)
    return strip
