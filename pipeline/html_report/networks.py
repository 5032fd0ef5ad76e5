"""What a run says about egocentric networks and about verbs."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from assemblyhands_core.metrics.verbs import TABLE
from pipeline.ego_evaluation import egocentric_grid, egocentric_rows
from pipeline.finished import FinishedRun
from pipeline.grids import Grid
from pipeline.html_report.page import Block, Fold, Table, Text
from pipeline.measured import NothingToShow
from pipeline.paper import EGOCENTRIC_MM, VERBS
from pipeline.verb_evaluation import odd_labels, verb_grid, verb_rows

Rows = Sequence[Mapping[str, Any]]

_OF_PAPER: Final = (
    "On real data: the paper's labels, people and split are its own. It does not say what its average is of: it is not "
    "the mean of its six columns."
)


def egocentric(run: FinishedRun) -> Iterator[Block]:
    """Yield each network against each kind of labels, beside the paper's Table 4."""
    rows = egocentric_rows(run.folder)
    if not rows:
        raise NothingToShow("this run has no egocentric network's figures: `predict`, `cross` do.")
    grid = egocentric_grid(rows)
    paper = [EGOCENTRIC_MM.get((row[0], row[1])) for row in grid.rows]
    lines = [[*row, "–" if mm is None else f"{mm:.2f}"] for row, mm in zip(grid.rows, paper, strict=True)]
    beside = Grid(grid.title, [*grid.columns, "paper, real data (mm)"], lines)
    note = "Paper: Table 4, SVEgoNet by what it was trained (Train-) and evaluated (Eval-) on; its best is 21.92 mm."
    yield Table(beside, note=note)


def verbs(run: FinishedRun) -> Iterator[Block]:
    """Yield accuracies by source of poses, beside the paper's Table 5, confusions, and which labels are odd."""
    rows = verb_rows(run.folder)
    if not rows:
        raise NothingToShow("this run has no figures about verbs: `verbs` and `train_verbs` do.")
    for name in dict.fromkeys(row["classifier"] for row in rows):
        own = [row for row in rows if row["classifier"] == name]
        yield Table(verb_grid(name, own))
        yield Fold(f"Which verb is taken for which: {name}", list(_confusions(own)))
    yield Table(VERBS, note=_OF_PAPER)
    odd = odd_labels(run.folder)
    yield from (Text(f"{line}.") for line in odd.counts)
    if odd.sentences:
        grid = Grid("Each once", ["row or segment"], [[sentence] for sentence in odd.sentences])
        yield Fold("Action labels that are odd or were left out", [Table(grid)])


def _confusions(rows: Rows) -> Iterator[Block]:
    cells = [row for row in rows if row["table"] == f"{TABLE}_confusion"]
    for source in dict.fromkeys(row["row"] for row in cells):
        of_source = {(row["group"], row["metric"]): row for row in cells if row["row"] == source}
        predicted = list(dict.fromkeys(metric for _, metric in of_source))
        lines = [
            [verb, *(_share(of_source.get((verb, name))) for name in predicted), str(_count(of_source, verb))]
            for verb in dict.fromkeys(group for group, _ in of_source)
        ]
        columns = ["true verb", *(f"told: {name}" for name in predicted), "segments"]
        grid = _marked(Grid(f"{source}: told verb by true verb (%)", columns, lines))
        yield Table(grid, shaded=range(1, len(columns) - 1))


def _marked(grid: Grid) -> Grid:
    """Return a confusion matrix whose right answers are marked."""
    rows = [[f"{cell} ✓" if name == f"told: {row[0]}" and cell != "–" else cell
             for name, cell in zip(grid.columns, row, strict=True)] for row in grid.rows]  # fmt: skip
    return Grid(grid.title, grid.columns, rows)


def _share(row: Mapping[str, Any] | None) -> str:
    return "–" if row is None or row["value"] != row["value"] else f"{row['value']:.0f}"


def _count(cells: Mapping[tuple[str, str], Mapping[str, Any]], verb: str) -> int:
    return max(int(row["n"]) for (group, _), row in cells.items() if group == verb)
