"""Differences of figures between two runs as tables, with a verdict where the interval says so."""

from collections.abc import Mapping, Sequence
from typing import Final

from assemblyhands_core.metrics.run_differences import Difference
from assemblyhands_core.viz.figures import method_label
from pipeline.evaluation import METRIC_NAMES
from pipeline.grids import Grid

METRICS: Final = {
    **{name: METRIC_NAMES[name] for name in ("coverage", "mpjpe_mm")},
    "wrist_relative_mpjpe_mm": "wrist-relative MPJPE (mm)",
    **METRIC_NAMES,
    "pck_20mm": "PCK at 20 mm (%)",
    "identity_accuracy": "hand identity (%)",
    "mean_verb_accuracy": "accuracy, mean over verbs (%)",
    "accuracy": "accuracy (%)",
    "pose_error_mm": "pose error (mm)",
    "pose_coverage": "hands seen (%)",
}
"""What they are called, in the order of the rows."""
_SURE, _UNSURE, _EQUAL = "{} is better", "no sure difference", "equal"
_NEUTRAL: Final = frozenset({"own"})
"""Metrics of which more is neither better nor worse."""

Found = Mapping[str, Sequence[Difference]]
"""What was compared, such as a method → its differences."""


def tables_of(found: Found) -> list[str]:
    """Return the names of the tables: the one over everything, then those by group."""
    return list(dict.fromkeys(d.table for differences in found.values() for d in differences))


def of_table(found: Found, table: str) -> list[Difference]:
    """Return what a table has, each with the name of what was compared; metrics in the order of `METRICS`."""
    order = list(METRICS)
    return [
        d._replace(group=", ".join(filter(None, (method_label(method), d.group))))
        for method, of_method in found.items()
        for d in sorted(of_method, key=lambda d: order.index(d.metric))
        if d.table == table
    ]


def difference_grid(title: str, names: tuple[str, str], found: Sequence[Difference]) -> Grid:
    """Return a line for each difference, with the run that is better where that is sure.

    Args:
        title: What they are of.
        names: Of the runs.
        found: What to show; groups say what each is of.
    """
    first, second = names
    rows = [
        [
            d.group,
            METRICS[d.metric],
            plain_number(d.first),
            plain_number(d.second),
            _with_interval(d),
            _verdict(d, names),
            str(d.n),
        ]
        for d in found
    ]
    columns = ["of", "metric", first, second, f"{first} − {second} (95 % interval)", "verdict", "n"]
    return Grid(title, columns, rows)


def _verdict(found: Difference, names: tuple[str, str]) -> str:
    """Return which run is better; only where the whole interval says so."""
    if found.value == found.low == found.high == 0:
        return _EQUAL
    if not (found.low > 0 or found.high < 0):
        return _UNSURE
    if found.metric in _NEUTRAL:
        return "they differ"
    is_first_better = (found.value < 0) == found.metric.endswith("_mm")
    return _SURE.format(names[0] if is_first_better else names[1])


def _with_interval(found: Difference) -> str:
    if found.value == found.low == found.high == 0:
        return "0"
    bounds = "" if found.low != found.low else f" ({found.low:+.3f} to {found.high:+.3f})"
    return "–" if found.value != found.value else f"{found.value:+.3f}{bounds}"


def plain_number(value: float) -> str:
    """Return a figure as tables show it; a dash where there is none."""
    return "–" if value != value else f"{value:.3f}"
