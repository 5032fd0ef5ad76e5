"""Figures of annotation quality: PCK curves of methods, the error from round to round, differences between runs.

They take figures that were worked out elsewhere (`metrics`) and only draw them. Every title names the recordings, which
the caller has to say: a figure on synthetic recordings must never pass for one on real data. Colours are those of Okabe
and Ito, the same method or finger always in its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from jaxtyping import Float

from assemblyhands_core.hands.joints import FINGERS, JOINT_NAMES, WRIST
from assemblyhands_core.viz.overlays import FINGER_COLORS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI: Final = 100
_LABELS: Final = {"2d_triangulation": "2D + triangulation"}
_STYLES: Final = {
    "2d_triangulation": ("#0072B2", "-"),
    "R1": ("#E69F00", "-"),
    "R2": ("#009E73", "-"),
    "R3": ("#D55E00", "-"),
    "true crops and root": ("#000000", "--"),
}
_OTHER_COLORS: Final = ("#CC79A7", "#56B4E9", "#999999", "#B8A800")
_DASHES: Final = ("--", "-.", ":")
_MARKERS: Final = "osD^vPX"  # colours alone would not do for those who do not see them, nor on paper
_GROUP_COLORS: Final = {
    **{finger: "#{:02X}{:02X}{:02X}".format(*color) for finger, color in zip(FINGERS, FINGER_COLORS, strict=True)},
    JOINT_NAMES[WRIST]: "#777777",
}
_SIDESTEP: Final = 0.05  # of a round: groups stand beside one another, or their intervals would hide each other


@dataclass(frozen=True, eq=False)
class PckCurve:
    """How many joints of a method are near the truth.

    Attributes:
        method: Its name, a row of the evaluation's tables.
        thresholds_mm: Ascending from 0.
        correct_percent: Of all labelled joints, those at most as far off; a missing joint never is.
        auc_percent: Area under the curve over the range.
        coverage_percent: Found among the labelled joints.
        num_joints: That are labelled.
    """

    method: str
    thresholds_mm: Float[np.ndarray, " threshold"]
    correct_percent: Float[np.ndarray, " threshold"]
    auc_percent: float
    coverage_percent: float
    num_joints: int


@dataclass(frozen=True)
class RoundError:
    """The mean error of a method over a group of joints.

    Attributes:
        method: Its name: 2D + triangulation, or a round after it.
        group: A finger or the wrist; empty for all joints.
        mpjpe_mm: Over the joints that were found.
        low_mm, high_mm: 95 % bootstrap interval; NaN where there is none.
        coverage_percent: Found among the labelled joints.
        num_joints: That were found.
    """

    method: str
    group: str
    mpjpe_mm: float
    low_mm: float
    high_mm: float
    coverage_percent: float
    num_joints: int


def method_label(method: str) -> str:
    """Return what readers call a method."""
    return _LABELS.get(method, method)


def pck_figure(curves: Sequence[PckCurve], recordings: str) -> "Figure":
    """Return the PCK curves of methods, with the area under each in the legend (paper, supplement C).

    Args:
        curves: One for each method, over the same range.
        recordings: What they are of, for the title: "synthetic recordings".

    Raises:
        ValueError: There are no curves.
    """
    if not curves:
        raise ValueError("A figure of PCK curves needs at least one method; evaluate one.")
    figure, (axes,) = _figure(1, (7.0, 5.0))
    colors = _colors([curve.method for curve in curves])
    for number, (curve, (color, dashes)) in enumerate(zip(curves, colors, strict=True)):
        label = f"{method_label(curve.method)}: AUC {curve.auc_percent:.1f} %, {curve.coverage_percent:.1f} % found"
        (line,) = axes.plot(curve.thresholds_mm, curve.correct_percent, color=color, linestyle=dashes, linewidth=2)
        marker, every = _MARKERS[number % len(_MARKERS)], max(1, len(curve.thresholds_mm) // 10)
        line.set(label=label, marker=marker, markersize=6, markevery=(number % every, every))
    axes.set(xlim=(0, curves[0].thresholds_mm[-1]), ylim=(0, 100))
    axes.set(xlabel="distance to the truth (mm)", ylabel="joints within that distance (%)")
    axes.set_title(f"PCK on {recordings}\n{curves[0].num_joints:,} joints, missing ones count as wrong")
    axes.legend(loc="lower right")
    return figure


def round_figure(errors: Sequence[RoundError], recordings: str, bound: RoundError | None = None) -> "Figure":
    """Return the mean error from round to round with its intervals: over all joints, and by finger.

    Args:
        errors: Of each method the error over all joints and of any groups; methods in the order of rounds.
        recordings: What they are of, for the title: "synthetic recordings".
        bound: What a round would reach that started from the truth, over all joints.

    Raises:
        ValueError: There are fewer than two methods.
    """
    everything = [error for error in errors if not error.group]
    methods = [error.method for error in everything]
    if len(methods) < 2:
        raise ValueError(f"A figure of rounds needs at least two methods, got {', '.join(methods) or 'none'}.")
    figure, panels = _figure(2, (11.0, 5.0))
    _draw_all_joints(panels[0], everything, methods, bound)
    groups = [name for name in _GROUP_COLORS if any(error.group == name for error in errors)]
    for number, name in enumerate(groups):
        of_group = [error for error in errors if error.group == name]
        shift = _SIDESTEP * (number - (len(groups) - 1) / 2)
        marker = _MARKERS[number % len(_MARKERS)]
        _draw_course(panels[1], of_group, methods, (name, _GROUP_COLORS[name], marker), shift)
    if groups:
        panels[1].legend(loc="lower left", ncols=3)
    _label_rounds(panels, everything, methods)
    title = f"Error by round on {recordings}: mean over the joints found, 95 % bootstrap intervals"
    figure.suptitle(title, fontsize="large")
    return figure


class Change(NamedTuple):
    """By how much a figure differs between two runs, with its paired interval."""

    label: str
    value: float
    low: float
    high: float


def change_figure(changes: Sequence[Change], unit: str, recordings: str) -> "Figure":
    """Return differences below one another, each with its interval; the line is where there is none.

    Args:
        changes: At least one, in the order of the lines.
        unit: What they are in, and which run is subtracted from which.
        recordings: What they are of.

    Raises:
        ValueError: There is nothing to draw.
    """
    if not changes:
        raise ValueError("A figure of differences needs at least one; compare runs that have a method in common.")
    figure, (axes,) = _figure(1, (7.0, 1.4 + 0.28 * len(changes)))
    places = range(len(changes))
    value, low, high = np.array([change[1:] for change in changes]).T
    axes.axvline(0, color="#000000", linewidth=1, linestyle="--")
    axes.errorbar((low + high) / 2, places, xerr=(high - low) / 2, fmt="none", ecolor="#0072B2", capsize=3)
    axes.plot(value, places, color="#0072B2", marker="o", linestyle="none")
    axes.set_yticks(places, [change.label for change in changes])
    axes.invert_yaxis()
    axes.set(xlabel=unit)
    axes.set_title(f"Differences on {recordings}, 95 % paired intervals")
    return figure


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG of 100 dpi."""
    figure.savefig(path, dpi=DPI)


def _figure(num_panels: int, size_inches: tuple[float, float]) -> "tuple[Figure, list[Axes]]":
    """Return a figure that no window manager and no global state knows of, so that workers may draw, too."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(1, num_panels, sharey=True, squeeze=False)[0])
    for axes in panels:
        axes.grid(color="#DDDDDD")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure, panels


def _draw_all_joints(
    axes: "Axes", errors: Sequence[RoundError], methods: Sequence[str], bound: RoundError | None
) -> None:
    _draw_course(axes, errors, methods, ("all joints", "#000000", "o"), 0.0)
    for place, error in enumerate(errors):
        if np.isfinite(error.mpjpe_mm):
            axes.annotate(f"{error.mpjpe_mm:.2f}", (place, error.mpjpe_mm), (9, 7), textcoords="offset points")
    if bound is not None:
        ((color, dashes),) = _colors([bound.method])
        label = f"{bound.method}: {bound.mpjpe_mm:.2f} mm ({_found(bound)})"
        axes.axhline(bound.mpjpe_mm, color=color, linestyle=dashes, linewidth=1, label=label)
        axes.legend(loc="lower left")  # the axis begins at 0, errors do not


def _draw_course(
    axes: "Axes", errors: Sequence[RoundError], methods: Sequence[str], style: tuple[str, str, str], shift: float
) -> None:
    """Draw one group's errors over the methods, with intervals where they are known; style: label, colour, marker."""
    label, color, marker = style
    x = [methods.index(error.method) + shift for error in errors]
    value, low, high = np.array([(error.mpjpe_mm, error.low_mm, error.high_mm) for error in errors]).T
    axes.plot(x, value, color=color, marker=marker, markersize=5, linewidth=1.5, label=label)
    # Around its own middle: an interval of percentiles need not hold the value.
    axes.errorbar(x, (low + high) / 2, yerr=(high - low) / 2, fmt="none", ecolor=color, elinewidth=1.5, capsize=3)


def _label_rounds(panels: "Sequence[Axes]", everything: Sequence[RoundError], methods: Sequence[str]) -> None:
    names = [method_label(method).replace(" + ", " +\n") for method in methods]
    found = [_found(error).replace(", ", "\n") for error in everything]
    panels[0].set_xticks(range(len(methods)), [f"{name}\n{of}" for name, of in zip(names, found, strict=True)])
    panels[1].set_xticks(range(len(methods)), names)
    panels[0].set(title="all joints", ylabel="MPJPE (mm)", xlim=(-0.4, len(methods) - 0.4))
    panels[1].set(title="by finger", xlim=(-0.4, len(methods) - 0.4))
    panels[0].set_ylim(bottom=0)
    panels[1].tick_params(labelleft=True)


def _found(error: RoundError) -> str:
    return f"{error.coverage_percent:.1f} % found, n = {error.num_joints:,}"


def _colors(methods: Sequence[str]) -> list[tuple[str, str]]:
    """Return colour and dashes of each method: known ones have their own, others what is left, dashed."""
    styles = dict(_STYLES)
    for number, method in enumerate(method for method in methods if method not in _STYLES):
        styles[method] = _OTHER_COLORS[number % len(_OTHER_COLORS)], _DASHES[number % len(_DASHES)]
    return [styles[method] for method in methods]
