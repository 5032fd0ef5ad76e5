"""Figures, by the numbers that stand in them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from assemblyhands_core.viz.figures import (
    Change,
    PckCurve,
    RoundError,
    change_figure,
    pck_figure,
    round_figure,
    save_figure,
)
from assemblyhands_core.viz.overlays import FINGER_COLORS

THRESHOLDS_MM = np.linspace(0.0, 20.0, 5)


def _curve(method: str, *correct_percent: float, num_joints: int = 12345) -> PckCurve:
    values = np.array(correct_percent, dtype=np.float64)
    area = float(np.trapezoid(values, THRESHOLDS_MM) / 20)
    return PckCurve(method, THRESHOLDS_MM, values, area, 97.5, num_joints)


def _rounds(**mpjpe_mm: float) -> list[RoundError]:
    return [RoundError(name, "", value, value - 0.5, value + 1.0, 99.0, 840) for name, value in mpjpe_mm.items()]


def _legend(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def _ticks(axes: Any) -> list[str]:
    return [label.get_text() for label in axes.get_xticklabels()]


def _intervals(axes: Any) -> list[np.ndarray]:
    """The upright lines (2, 2) of all intervals, in the order in which they were drawn."""
    return [line for lines in axes.collections for line in lines.get_segments()]


def test_pck_curves_are_the_given_ones_with_their_area() -> None:
    curves = [_curve("2d_triangulation", 0, 20, 40, 60, 80), _curve("R1", 0, 80, 90, 95, 100)]
    (axes,) = pck_figure(curves, "synthetic recordings").axes
    for line, curve in zip(axes.get_lines(), curves, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), THRESHOLDS_MM)
        np.testing.assert_array_equal(line.get_ydata(), curve.correct_percent)
    # By hand: (20 + 40 + 60 + 80/2) / 4 = 40 and (80 + 90 + 95 + 100/2) / 4 = 78.75.
    assert _legend(axes) == ["2D + triangulation: AUC 40.0 %, 97.5 % found", "R1: AUC 78.8 %, 97.5 % found"]
    assert axes.get_xlim() == (0, 20) and axes.get_ylim() == (0, 100)
    assert axes.get_xlabel() == "distance to the truth (mm)" and "(%)" in axes.get_ylabel()
    assert axes.get_title() == "PCK on synthetic recordings\n12,345 joints, missing ones count as wrong"


def test_a_method_has_the_same_colour_whatever_else_is_drawn() -> None:
    def styles(*methods: str) -> dict[str, tuple[Any, str]]:
        (axes,) = pck_figure([_curve(name, 0, 1, 2, 3, 4) for name in methods], "x").axes
        return {
            name: (line.get_color(), line.get_linestyle()) for name, line in zip(methods, axes.get_lines(), strict=True)
        }

    some = styles("R3", "mediapipe", "2d_triangulation")
    every = styles("2d_triangulation", "mediapipe", "true crops and root", "ego", "R1", "R2", "R3", "R4")
    assert {name: every[name] for name in some} == some
    assert len(set(every.values())) == len({color for color, _ in every.values()}) == 8
    assert [every[name][1] for name in ("R1", "R2", "R3")] == ["-"] * 3 and every["mediapipe"][1] != "-"


def test_errors_by_round_are_the_given_ones_with_their_intervals() -> None:
    errors = _rounds(**{"2d_triangulation": 8.0, "R1": 6.0, "R2": 5.25})
    errors += [RoundError(name, "index", 3.0 + k, 2.0, 4.5, 98.0, 160) for k, name in enumerate(("R1", "R2"))]
    errors.append(RoundError("R1", "wrist", 1.0, 0.5, 1.5, 98.0, 40))
    figure = round_figure(errors, "synthetic recordings")
    everything, by_finger = figure.axes
    (line,) = everything.get_lines()[:1]
    np.testing.assert_array_equal(line.get_xdata(), (0, 1, 2))
    np.testing.assert_array_equal(line.get_ydata(), (8.0, 6.0, 5.25))
    np.testing.assert_allclose(_intervals(everything), [[[0, 7.5], [0, 9]], [[1, 5.5], [1, 7]], [[2, 4.75], [2, 6.25]]])
    assert [text.get_text() for text in everything.texts] == ["8.00", "6.00", "5.25"]
    assert _ticks(everything)[:2] == ["2D +\ntriangulation\n99.0 % found\nn = 840", "R1\n99.0 % found\nn = 840"]
    assert everything.get_ylabel() == "MPJPE (mm)" and everything.get_ylim()[0] == 0
    assert figure.get_suptitle().startswith("Error by round on synthetic recordings")
    assert _legend(by_finger) == ["index", "wrist"] and _ticks(by_finger) == ["2D +\ntriangulation", "R1", "R2"]
    lines = {line.get_label(): line for line in by_finger.get_lines() if line.get_label() in ("index", "wrist")}
    np.testing.assert_allclose(lines["index"].get_xydata(), [[0.975, 3.0], [1.975, 4.0]])
    np.testing.assert_allclose(lines["wrist"].get_xydata(), [[1.025, 1.0]])
    assert lines["index"].get_color() == "#{:02X}{:02X}{:02X}".format(*FINGER_COLORS[1])
    np.testing.assert_allclose(_intervals(by_finger)[0], [[0.975, 2.0], [0.975, 4.5]])


def test_the_upper_bound_is_a_level_and_no_round() -> None:
    bound = RoundError("true crops and root", "", 3.25, 3.0, 3.5, 100.0, 42)
    (everything, _) = round_figure(_rounds(R1=6.0, R2=5.0), "x", bound).axes
    (level,) = [line for line in everything.get_lines() if str(line.get_label()).startswith("true crops")]
    assert set(level.get_ydata()) == {3.25} and level.get_linestyle() == "--"
    assert "true crops and root: 3.25 mm (100.0 % found, n = 42)" in _legend(everything)
    assert len(_ticks(everything)) == 2
    assert round_figure(_rounds(R1=6.0, R2=5.0), "x").axes[0].get_legend() is None


def test_an_interval_is_drawn_where_it_is_even_beside_its_value_and_not_where_it_is_unknown(tmp_path: Path) -> None:
    odd = [RoundError("R1", "", 6.0, 6.5, 7.0, 99.0, 9), RoundError("R2", "", np.nan, np.nan, np.nan, 0.0, 0)]
    figure = round_figure(odd, "x")
    first, second = _intervals(figure.axes[0])
    np.testing.assert_allclose(first, [[0, 6.5], [0, 7.0]])
    assert not second.size and len(figure.axes[0].texts) == 1
    save_figure(figure, tmp_path / "odd.png")


def test_a_figure_is_saved_at_100_dpi_and_twice_alike(tmp_path: Path) -> None:
    for name in "ab":
        save_figure(pck_figure([_curve("R1", 0, 25, 50, 75, 100)], "x"), tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    image: Any = cv2.cvtColor(cv2.imread(str(tmp_path / "a.png")), cv2.COLOR_BGR2RGB)
    assert image.shape == (500, 700, 3)
    orange = (image == (0xE6, 0x9F, 0x00)).all(axis=-1)
    rows, columns = np.nonzero(orange)
    # The curve is the diagonal of the axes; the legend's sample of it lies below.
    slope, _ = np.polyfit(columns[rows < 250], rows[rows < 250], 1)
    assert orange.sum() > 500 and -1.0 < slope < -0.4


def test_differences_stand_below_one_another_with_their_intervals() -> None:
    changes = [Change("R1", -0.5, -0.6, -0.3), Change("R1, thumb", 0.1, -0.1, 0.4)]
    (axes,) = change_figure(changes, "MPJPE (mm): a − b", "synthetic recordings").axes
    zero, points = axes.lines[0], axes.lines[-1]
    assert set(zero.get_xdata()) == {0} and list(points.get_xdata()) == [-0.5, 0.1]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["R1", "R1, thumb"]
    bars = [bar[:, 0].tolist() for bar in _intervals(axes)]
    np.testing.assert_allclose(bars, [[-0.6, -0.3], [-0.1, 0.4]], atol=1e-12)
    assert axes.get_ylim()[0] > axes.get_ylim()[1], "the first one stands on top"
    assert axes.get_xlabel() == "MPJPE (mm): a − b" and "synthetic recordings" in axes.get_title()


def test_figures_that_show_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        change_figure([], "mm", "synthetic recordings")
    with pytest.raises(ValueError, match="at least one method"):
        pck_figure([], "x")
    with pytest.raises(ValueError, match="at least two methods, got R1"):
        round_figure(_rounds(R1=3.0), "x")
