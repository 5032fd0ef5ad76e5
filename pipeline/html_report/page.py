"""What a page is made of, and how it becomes one HTML file.

Nothing in it is fetched: style, script and pictures are inside, and its policy forbids everything else. Whatever comes
from data (names, reasons, notes) is escaped by the template.
"""

import base64
import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import ClassVar, Final

import jinja2
import pyarrow as pa
from markupsafe import Markup

from pipeline.grids import Grid, leading_number
from pipeline.measured import NothingToShow

MAX_PICTURE_BYTES: Final = 8_000_000
"""Of all pictures of a page together, as they stand in it."""
MAX_ROWS: Final = 1000
"""Of a table."""
_UNREADABLE: Final = (KeyError, OSError, pa.ArrowException)
_NO_FIGURE: Final = frozenset({"", "–"})
_WIDE_FROM: Final = 12
"""Columns, which are set smaller on paper."""
_TEMPLATES: Final = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Text:
    """A paragraph; what stands between backticks is code."""

    kind: ClassVar[str] = "text"
    text: str
    is_warning: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose columns can be sorted.

    Attributes:
        grid: Its cells.
        shaded: Columns whose numbers are underlaid the darker the larger they are; the first column is 0.
        note: Stands below it.
    """

    kind: ClassVar[str] = "table"
    grid: Grid
    shaded: range = range(0)
    note: str = ""

    @property
    def rows(self) -> Sequence[Sequence[str]]:
        """Return the rows that are shown."""
        return self.grid.rows[:MAX_ROWS]

    @property
    def num_left_out(self) -> int:
        """Return how many rows are not."""
        return max(0, len(self.grid.rows) - MAX_ROWS)

    @cached_property
    def numeric(self) -> frozenset[int]:
        """Return the columns that hold numbers and no words."""
        columns = {
            column: {row[column] for row in self.rows} - _NO_FIGURE for column in range(1, len(self.grid.columns))
        }
        are_numbers = {
            column: [leading_number(cell) is not None for cell in cells] for column, cells in columns.items()
        }
        return frozenset(column for column, are in are_numbers.items() if are and all(are))

    @property
    def is_wide(self) -> bool:
        """Return whether it has so many columns that paper is too narrow for it."""
        return len(self.grid.columns) >= _WIDE_FROM

    def share(self, column: int, cell: str) -> float | None:
        """Return a number's share of the largest one, in columns that are shaded."""
        number = leading_number(cell) if column in self.shaded else None
        return None if number is None or self._largest <= 0 else max(0.0, number / self._largest)

    @cached_property
    def _largest(self) -> float:
        numbers = (leading_number(row[column]) for row in self.rows for column in self.shaded)
        return max((number for number in numbers if number is not None), default=0.0)


@dataclass(frozen=True)
class Picture:
    """A picture that stands in the page as a data URI.

    Attributes:
        uri: The picture.
        alt: What it shows, in words.
        caption: Stands below it.
        width_px: How wide it stands in the page; its own width by default.
    """

    kind: ClassVar[str] = "picture"
    uri: str
    alt: str
    caption: str = ""
    width_px: int | None = None


@dataclass(frozen=True)
class Drawings:
    """Drawings side by side under a head: SVG elements, which have to be safe, each with its caption."""

    kind: ClassVar[str] = "drawings"
    title: str
    drawings: Sequence[tuple[Markup, str]]


@dataclass(frozen=True)
class Fold:
    """Blocks that are folded away on the screen and stand open on paper, unless they are only for the screen."""

    kind: ClassVar[str] = "fold"
    title: str
    blocks: Sequence["Block"]
    is_printed: bool = True


Block = Text | Table | Picture | Drawings | Fold


@dataclass(frozen=True)
class Section:
    """A part of a page.

    Attributes:
        title: Its head.
        blocks: What it holds.
    """

    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)

    @property
    def anchor(self) -> str:
        """Return what links to it are made of."""
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes:
        title: Its head.
        lead: What it is, in a sentence or two.
        sections: Its parts.
    """

    title: str
    lead: str
    sections: Sequence[Section]

    def render(self) -> str:
        """Return the page as HTML."""
        bounded = replace(self, sections=_within_bounds(self.sections))
        script = _asset("page.js")
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        return _template().render(page=bounded, style=_asset("page.css"), script=script, script_digest=digest)


def sections(makers: Iterable[tuple[str, Callable[[], Iterable[Block]]]]) -> list[Section]:
    """Return the sections that there is something for; the last one says of the others why there is nothing.

    Tables that are gone, or of a version with other columns, cost a page the parts that need them and nothing else.

    Args:
        makers: Title of each section, and what makes its blocks or raises `NothingToShow`.
    """
    found, absent = [], dict[str, list[str]]()
    for title, make in makers:
        try:
            found.append(Section(title, list(make())))
        except NothingToShow as reason:
            absent.setdefault(str(reason), []).append(title)
        except _UNREADABLE as error:
            absent.setdefault(f"its tables are gone or of another version ({_first_line(error)}).", []).append(title)
    lines = [Text(f"{', '.join(titles)}: {reason}") for reason, titles in absent.items()]
    return [*found, Section("Not on this page", lines)] if lines else found


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def _within_bounds(sections: Sequence[Section]) -> list[Section]:
    """Return the sections with sentences in place of those pictures that are beyond the bound."""
    left = [MAX_PICTURE_BYTES]

    def bounded(block: Block) -> Block:
        if isinstance(block, Fold):
            return replace(block, blocks=[bounded(inner) for inner in block.blocks])
        if not isinstance(block, Picture):
            return block
        if len(block.uri) > left[0]:
            return Text(
                f"Left out, since the pictures of a page are held below {MAX_PICTURE_BYTES / 1e6:g} MB: {block.alt}"
            )
        left[0] -= len(block.uri)
        return block

    return [replace(section, blocks=[bounded(block) for block in section.blocks]) for section in sections]


def _asset(name: str) -> Markup:
    """Return a file of ours that goes into the page as it is."""
    return Markup((_TEMPLATES / name).read_text(encoding="utf-8"))


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html")
