"""The page in a real browser."""

import asyncio
import base64
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
from browser import Tab, chromium, first_tab
from error_tables import errors_table
from finished_run import write_errors
from html_runs import finished, write_run

from pipeline.html_report.writing import run_page

_PICTURES = "[...document.images].map((image) => image.complete && image.naturalWidth > 0)"
_COLUMN = "[...document.querySelectorAll('#sequences tbody tr')].map((row) => row.cells[{}].textContent)"
_SORTED = "document.querySelector('#sequences th:nth-child({}) ').getAttribute('aria-sort')"
_MPJPE = "[...document.querySelectorAll('#summary th')].find((head) => head.textContent == 'MPJPE of found (mm)')"
_FIGURES = f"[...{_MPJPE}.closest('table').tBodies[0].rows].map((row) => row.cells[{_MPJPE}.cellIndex].textContent)"


def test_it_opens_without_complaint_shows_its_pictures_and_sorts_its_tables(tmp_path: Path) -> None:
    write_run(tmp_path, "made_up")
    _on_page(tmp_path, _look)


def _on_page(folder: Path, look: Callable[[Tab], Awaitable[None]]) -> None:
    """Open the page of the run in a folder, and look at it."""
    page = folder / "report.html"
    page.write_text(run_page(finished(folder, "made_up")).render())

    async def opened(address: str) -> None:
        tab = await first_tab(address)
        await tab.open(page)
        await look(tab)

    with chromium(folder / "profile") as address:
        asyncio.run(opened(address))


async def _look(tab: Tab) -> None:
    pictures = await tab.evaluate(_PICTURES)
    assert len(pictures) >= 4 and all(pictures)
    assert await tab.evaluate("typeof hostile") == "undefined"
    await _sort(tab)
    printed = await tab.call("Page.printToPDF", printBackground=True)
    assert base64.b64decode(printed["data"]).startswith(b"%PDF")
    assert tab.complaints == [] and {url.split(":")[0] for url in tab.requests} <= {"file", "data"}


async def _sort(tab: Tab) -> None:
    """By a click, and by the keyboard."""
    names = await tab.evaluate(_COLUMN.format(0))
    await tab.evaluate("document.querySelector('#sequences th:nth-child(1) button').click()")
    ascending = await tab.evaluate(_COLUMN.format(0))
    assert ascending == sorted(names) and await tab.evaluate(_SORTED.format(1)) == "ascending"
    await tab.evaluate("document.querySelector('#sequences th:nth-child(1) button').focus()")
    await tab.press("Enter", 13, "\r")
    assert await tab.evaluate(_COLUMN.format(0)) == ascending[::-1]
    assert await tab.evaluate(_SORTED.format(1)) == "descending"


def test_figures_with_intervals_are_sorted_by_their_number_and_dashes_stand_last(tmp_path: Path) -> None:
    """By their letters 9.00 would be more than 10.00."""
    run = write_run(tmp_path, "made_up", sequences=())
    errors_mm = {"2d_triangulation": 9.0, "R1": np.nan, "R2": 10.0}
    write_errors(run, "s", errors_table({name: np.full((20, 2), mm) for name, mm in errors_mm.items()}))
    _on_page(tmp_path, _sort_figures)


async def _sort_figures(tab: Tab) -> None:
    nine, ten = "9.00 (9.00 to 9.00)", "10.00 (10.00 to 10.00)"
    assert await tab.evaluate(_FIGURES) == [nine, "–", ten]
    for order, figures in (("descending", [ten, nine, "–"]), ("ascending", [nine, ten, "–"])):
        await tab.evaluate(f"{_MPJPE}.querySelector('button').click()")
        assert await tab.evaluate(_FIGURES) == figures
        assert await tab.evaluate(f"{_MPJPE}.getAttribute('aria-sort')") == order
    assert tab.complaints == []
