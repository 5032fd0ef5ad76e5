"""What became of a figure as one parameter was varied, or two."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLORS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS: Final = "osD^vPX"


@dataclass(frozen=True)
class SweptValue:
    """A figure at a point of a sweep.

    Attributes:
        settings: Values of the parameters that were varied, as they were typed.
        value: The figure.
        low: Of its interval; NaN without one.
        high: Of its interval; NaN without one.
    """

    settings: tuple[str, ...]
    value: float
    low: float
    high: float


def sweep_figure(parameters: Sequence[str], name: str, values: Sequence[SweptValue]) -> "Figure":
    """Draw a figure over the first parameter, a line for each value of the second.

    Args:
        parameters: The one or two that were varied.
        name: What the figure is, with its unit.
        values: Points, in any order.

    Raises:
        ValueError: More than two parameters were varied, or none.
    """
    from matplotlib.figure import Figure

    if len(parameters) not in (1, 2):
        raise ValueError(f"One or two parameters can be drawn, not {len(parameters)}.")
    picture = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = picture.subplots()
    places = _places([value.settings[0] for value in values])
    for index, second in enumerate(_ordered({value.settings[1:] for value in values})):
        line = sorted((v for v in values if v.settings[1:] == second), key=lambda v: places[v.settings[0]])
        y = np.array([v.value for v in line])
        ends = np.array([[v.low, v.high] for v in line]).reshape(-1, 2)
        errors = np.nan_to_num(np.abs(ends.T - y))
        axes.errorbar(
            [places[v.settings[0]] for v in line],
            y,
            yerr=errors,
            color=_COLORS[index % len(_COLORS)],
            marker=_MARKERS[index % len(_MARKERS)],
            capsize=3,
            label=f"{parameters[1]}={second[0]}" if second else None,
        )
    axes.set_xticks(list(places.values()), list(places))
    axes.set(xlabel=parameters[0], ylabel=name)
    axes.grid(alpha=0.3)
    if len(parameters) > 1:
        axes.legend(frameon=False)
    return picture


def _places(settings: Sequence[str]) -> dict[str, float]:
    """Return where each value stands: numbers where they are, words side by side."""
    distinct = list(dict.fromkeys(settings))
    try:
        return {text: float(text) for text in sorted(distinct, key=float)}
    except ValueError:
        return {text: float(index) for index, text in enumerate(distinct)}


def _ordered(seconds: set[tuple[str, ...]]) -> list[tuple[str, ...]]:
    places = _places([second[0] for second in sorted(seconds) if second])
    return sorted(seconds, key=lambda second: places[second[0]] if second else 0.0)
