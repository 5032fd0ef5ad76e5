"""A figure for each joint, written onto a drawing of the hand.

The drawing is SVG, made of shapes and attributes alone, so that it can stand inside a page. A joint's figure is written
into its disc; the disc is the darker the larger the figure is, so that colour only repeats what the number says.
"""

from html import escape
from typing import Final

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.joints import BONES, JOINT_NAMES

_WIDTH, _HEIGHT, _RADIUS = 330, 380, 17
# The back of a right hand, fingers up: thumb, index, middle, ring, pinky from tip to base, then the wrist.
_PLACES: Final = (
    (26, 164), (46, 206), (74, 248), (116, 292),
    (88, 60), (94, 100), (102, 142), (116, 200),
    (152, 30), (154, 74), (156, 120), (160, 188),
    (218, 56), (212, 98), (206, 140), (202, 196),
    (296, 100), (282, 136), (268, 174), (244, 222),
    (168, 340),
)  # fmt: skip
_PALE: Final = np.array([247.0, 251.0, 255.0])
_DARK: Final = np.array([8.0, 48.0, 107.0])
_WHITE_TEXT_FROM: Final = 0.65


def hand_diagram(values: Float[np.ndarray, "joint=21"], span: tuple[float, float], caption: str) -> str:
    """Return a drawing of the hand as an SVG element, with each joint's figure on it.

    Args:
        values: A figure for each joint, AssemblyHands order; NaN where there is none.
        span: What the palest and the darkest disc stand for, so that drawings side by side can be compared.
        caption: What it shows; read out to those who cannot see it.
    """
    bones = [_bone(child, parent) for child, parent in BONES]
    joints = [_joint(joint, float(value), span) for joint, value in enumerate(values)]
    head = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" role="img"'
    return f'{head} aria-label="{escape(caption)}">{"".join(bones)}{"".join(joints)}</svg>'


def _bone(child: int, parent: int) -> str:
    (x1, y1), (x2, y2) = _PLACES[child], _PLACES[parent]
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="#777777" stroke-width="5"/>'


def _joint(joint: int, value: float, span: tuple[float, float]) -> str:
    (x, y), share = _PLACES[joint], _share(value, span)
    fill, ink = _color(share), "#FFFFFF" if share >= _WHITE_TEXT_FROM else "#000000"
    dashes = "" if np.isfinite(value) else ' stroke-dasharray="4 3"'
    return (
        f"<g><title>{JOINT_NAMES[joint]}: {_number(value)}</title>"
        f'<circle cx="{x}" cy="{y}" r="{_RADIUS}" fill="{fill}" stroke="#000000"{dashes}/>'
        f'<text x="{x}" y="{y + 4}" text-anchor="middle" font-size="12" fill="{ink}">{_number(value)}</text></g>'
    )


def _share(value: float, span: tuple[float, float]) -> float:
    low, high = span
    return float(np.clip((value - low) / (high - low), 0, 1)) if np.isfinite(value) and high > low else 0.0


def _color(share: float) -> str:
    return "#{:02X}{:02X}{:02X}".format(*(_PALE + share * (_DARK - _PALE)).round().astype(int))


def _number(value: float) -> str:
    """Return three figures at most, as many as fit into a disc."""
    if not np.isfinite(value):
        return "–"
    return f"{value:.2f}" if value < 10 else f"{value:.1f}" if value < 100 else f"{value:.0f}"
