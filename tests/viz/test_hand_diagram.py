"""The drawing of a hand, by what stands in it."""

import re
from xml.etree import ElementTree

import numpy as np

from assemblyhands_core.hands.joints import BONES, JOINT_NAMES
from assemblyhands_core.viz.hand_diagram import hand_diagram

VALUES = np.linspace(2.0, 22.0, 21)


def _elements(svg: str, tag: str) -> list[ElementTree.Element]:
    return list(ElementTree.fromstring(svg).iter(tag))


def test_every_joint_has_its_figure_in_its_disc_and_every_bone_is_drawn() -> None:
    svg = hand_diagram(VALUES, (2.0, 22.0), "errors")
    assert [element.text for element in _elements(svg, "title")] == [
        f"{name}: {number}" for name, number in zip(JOINT_NAMES, ("2.00", *(f"{v:.2f}" for v in VALUES[1:8]),
                                                                  *(f"{v:.1f}" for v in VALUES[8:])), strict=True)
    ]  # fmt: skip
    texts, discs = _elements(svg, "text"), _elements(svg, "circle")
    assert [text.get("x") for text in texts] == [disc.get("cx") for disc in discs]
    assert len(_elements(svg, "line")) == len(BONES) == 20


def test_discs_are_the_darker_the_larger_the_figure_and_never_touch() -> None:
    discs = _elements(hand_diagram(VALUES, (2.0, 22.0), "x"), "circle")
    greys = [sum(int(disc.get("fill", "")[k : k + 2], 16) for k in (1, 3, 5)) for disc in discs]
    assert greys == sorted(greys, reverse=True) and greys[0] > 700 and greys[-1] < 200
    places = np.array([[float(disc.get(name, "")) for name in ("cx", "cy")] for disc in discs])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)[~np.eye(21, dtype=bool)]
    assert apart.min() > 2 * float(discs[0].get("r", ""))


def test_figures_can_be_read_on_every_disc() -> None:
    """WCAG 2.1: contrast of text and ground is at least 4.5."""

    def luminance(color: str) -> float:
        channels = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    svg = hand_diagram(VALUES, (2.0, 22.0), "x")
    for disc, text in zip(_elements(svg, "circle"), _elements(svg, "text"), strict=True):
        light, dark = sorted((luminance(disc.get("fill", "")), luminance(text.get("fill", ""))), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.4, text.text


def test_a_missing_figure_is_a_dash_in_a_dashed_disc_and_captions_are_escaped() -> None:
    values = VALUES.copy()
    values[3] = np.nan
    svg = hand_diagram(values, (0.0, 0.0), '"<script>')
    discs, texts = _elements(svg, "circle"), _elements(svg, "text")
    assert texts[3].text == "–" and [disc.get("stroke-dasharray") is not None for disc in discs].index(True) == 3
    assert "<script" not in svg and not re.search(r'aria-label="[^"]*<', svg)
