"""A table as text: worked out once, printed on the terminal and put into reports."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from rich.markup import escape
from rich.table import Table

_NUMBER: Final = re.compile(r"[+-]?\d+(\.\d+)?(?=$|[ %×])")


@dataclass(frozen=True)
class Grid:
    """A table; the first cell of each row says what the row is of.

    Attributes:
        title: What it is of.
        columns: Their heads.
        rows: Cells, as many as there are columns.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


def rich_table(grid: Grid) -> Table:
    """Return a grid as the terminal shows it."""
    table = Table(*map(escape, grid.columns), title=escape(grid.title), title_justify="left")
    for row in grid.rows:
        table.add_row(*map(escape, row))
    return table


def leading_number(cell: str) -> float | None:
    """Return the number that a cell begins with, before its unit or interval; None where it is a word."""
    found = _NUMBER.match(cell)
    return float(found[0]) if found else None
