"""The page in a real browser."""

import asyncio
import base64
from pathlib import Path

from browser import Tab, chromium, first_tab
from html_runs import finished, write_run

from pipeline.html_report.writing import run_page

_PICTURES = "[...document.images].map((image) => image.complete && image.naturalWidth > 0)"
_COLUMN = "[...document.querySelectorAll('#sequences tbody tr')].map((row) => row.cells[{}].textContent)"
_SORTED = "document.querySelector('#sequences th:nth-child({}) ').getAttribute('aria-sort')"


def test_it_opens_without_complaint_shows_its_pictures_and_sorts_its_tables(tmp_path: Path) -> None:
    write_run(tmp_path, "made_up")
    page = tmp_path / "report.html"
    page.write_text(run_page(finished(tmp_path, "made_up")).render())
    with chromium(tmp_path / "profile") as address:
        asyncio.run(_look(address, page))


async def _look(address: str, page: Path) -> None:
    tab = await first_tab(address)
    await tab.open(page)
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
