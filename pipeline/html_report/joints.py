"""Errors by joint, drawn on a hand, and by finger, hand, verb and occlusion."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from markupsafe import Markup

from assemblyhands_core.hands.joints import JOINT_NAMES
from assemblyhands_core.metrics.annotation import TABLE, Cell
from assemblyhands_core.viz.figures import method_label
from assemblyhands_core.viz.hand_diagram import hand_diagram
from pipeline.evaluation import Pool
from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.annotation import judged_pools, pool_title
from pipeline.html_report.page import Block, Drawings, Fold, Table

_GROUPS: Final = ("finger", "hand", "verb", "occlusion")


def joints(run: FinishedRun) -> Iterator[Block]:
    """Yield each joint's error drawn on a hand, and tables by joint and other groups."""
    for pool in judged_pools(run):
        yield from _of_pool(run, pool)


def _of_pool(run: FinishedRun, pool: Pool) -> Iterator[Block]:
    cells = [cell for cell in run.measured.cells[pool.name] if cell.metric == "mpjpe_mm"]
    by_joint = {name: _by_joint(cells, name) for name in run.measured.ends(pool)}
    shown = {name: values for name, values in by_joint.items() if np.isfinite(values).any()}
    if not shown:
        return
    yield from _drawings(pool, shown)
    grids = [_by_group(cells, "joint"), *(_by_group(cells, name) for name in _GROUPS)]
    tables = [Table(grid, shaded=range(1, len(grid.columns) - 2)) for grid in grids if grid.rows]
    yield Fold(f"Tables by joint, {', '.join(_GROUPS[:-1])} and {_GROUPS[-1]}; {pool_title(pool)}", tables)


def _drawings(pool: Pool, shown: dict[str, np.ndarray]) -> Iterator[Block]:
    low = min(float(np.nanmin(values)) for values in shown.values())
    high = max(float(np.nanmax(values)) for values in shown.values())
    drawings = []
    for name, values in shown.items():
        caption = f"{method_label(name)}: mean error (mm); palest disc {low:.2f}, darkest {high:.2f}"
        drawings.append((Markup(hand_diagram(values, (low, high), caption)), caption))
    yield Drawings(f"{pool_title(pool)}, both hands; missing joints do not count", drawings)


def _by_joint(cells: Sequence[Cell], method: str) -> np.ndarray:
    found = {cell.group: cell.value for cell in cells if cell.table == f"{TABLE}_by_joint" and cell.row == method}
    return np.array([found.get(name, np.nan) for name in JOINT_NAMES])


def _by_group(cells: Sequence[Cell], kind: str) -> Grid:
    """Return MPJPE by group and method, a dash where a method has nothing of a group.

    Beside it the least coverage and number of joints of the methods that have it.
    """
    found = {(cell.group, cell.row): cell for cell in cells if cell.table == f"{TABLE}_by_{kind}"}
    groups, methods = (list(dict.fromkeys(key[place] for key in found)) for place in (0, 1))
    rows = []
    for group in groups:
        figures = [_figure(found[group, method].value, 2) if (group, method) in found else "–" for method in methods]
        of_group = [cell for (name, _), cell in found.items() if name == group]
        coverage, n = min(cell.coverage for cell in of_group), min(cell.n for cell in of_group)
        rows.append([group, *figures, _figure(coverage, 1), str(n)])
    columns = [kind, *(f"{method_label(name)} (mm)" for name in methods), "found, least (%)", "n, least"]
    return Grid(f"MPJPE by {kind}", columns, rows)


def _figure(value: float, digits: int) -> str:
    return "–" if np.isnan(value) else f"{value:.{digits}f}"
