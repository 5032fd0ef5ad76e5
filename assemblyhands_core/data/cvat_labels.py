"""The labels of a CVAT task in which hands are skeletons: what its field "Raw" takes."""

from typing import Any, Final

from assemblyhands_core.hands.joints import BONES, FINGERS, HANDS, JOINT_NAMES, NUM_JOINTS, WRIST

_COLOURS: Final = ("#D55E00", "#E69F00", "#009E73", "#0072B2", "#CC79A7", "#444444")  # fingers and wrist; Okabe & Ito
_HAND_COLOURS: Final = {"right": "#D55E00", "left": "#0072B2"}


def cvat_labels() -> list[dict[str, Any]]:
    """Return a label for each hand, called as the COCO files call them, with a point for each joint in our order."""
    return [
        {
            "name": f"{hand}_hand",
            "color": _HAND_COLOURS[hand],
            "type": "skeleton",
            "attributes": [],
            "sublabels": [
                {"name": name, "color": _colour(joint), "type": "points", "attributes": []}
                for joint, name in enumerate(JOINT_NAMES)
            ],
            "svg": _svg(is_mirrored=hand == "left"),
        }
        for hand in HANDS
    ]


def _svg(is_mirrored: bool) -> str:
    """Return the drawing of a hand, 100 units wide, whose circles are the points, counted from 1."""
    places = [_place(joint, is_mirrored) for joint in range(NUM_JOINTS)]
    edges = (
        f'<line x1="{places[a][0]}" y1="{places[a][1]}" x2="{places[b][0]}" y2="{places[b][1]}" stroke="black" '
        f'stroke-width="0.5" data-type="edge" data-node-from="{a + 1}" data-node-to="{b + 1}"></line>'
        for a, b in BONES
    )
    nodes = (
        f'<circle r="1.5" stroke="black" stroke-width="0.1" fill="{_colour(joint)}" cx="{x}" cy="{y}" '
        f'data-type="element node" data-element-id="{joint + 1}" data-node-id="{joint + 1}" '
        f'data-label-name="{JOINT_NAMES[joint]}"></circle>'
        for joint, (x, y) in enumerate(places)
    )
    return "".join([*edges, *nodes])


def _place(joint: int, is_mirrored: bool) -> tuple[float, float]:
    """Return where a joint is in the drawing: the back of a hand, fingers up."""
    if joint == WRIST:
        return 50.0, 95.0
    finger, end = divmod(joint, 4)
    x, y = 14 + 18.0 * finger + (1 - finger / 2) * 2 * end, 10.0 + (18 if finger == 0 else 15) * end
    y += (25, 5, 0, 5, 15)[finger]
    return (100 - x if is_mirrored else x), y


def _colour(joint: int) -> str:
    return _COLOURS[len(FINGERS) if joint == WRIST else joint // 4]
