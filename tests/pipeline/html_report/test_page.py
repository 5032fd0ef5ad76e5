"""How blocks become a page: escaped, bounded, whole."""

import re
from collections.abc import Iterator
from functools import partial

import pyarrow as pa
import pytest
from markupsafe import Markup

from pipeline.grids import Grid
from pipeline.html_report import page as pages
from pipeline.html_report.page import Drawings, Fold, Page, Picture, Section, Table, Text
from pipeline.measured import NothingToShow

HOSTILE = "</script><script>hostile()</script>\"'><img src=x onerror=hostile()>"


def _html(*blocks: pages.Block) -> str:
    return Page("title", "lead", [Section("part", blocks)]).render()


def test_whatever_comes_from_data_is_escaped() -> None:
    table = Table(Grid(HOSTILE, [HOSTILE, HOSTILE], [[HOSTILE, HOSTILE]]), note=HOSTILE)
    picture, drawing = (
        Picture("data:image/png;base64,", HOSTILE, HOSTILE),
        Drawings(HOSTILE, [(Markup("<svg></svg>"), HOSTILE)]),
    )
    blocks = [Text(HOSTILE), Text(f"`{HOSTILE}`"), table, picture, drawing, Fold(HOSTILE, [Text(HOSTILE)])]
    html = Page(HOSTILE, HOSTILE, [Section(HOSTILE, blocks)]).render()
    assert html.count("<script>") == html.count("</script>") == 1 and "<img src=x" not in html
    assert html.count("&lt;script&gt;hostile()") >= 14 and "<svg></svg>" in html
    assert not re.search(r'id="[^"]*[<>]', html)


def test_a_page_asks_for_nothing_and_allows_no_script_but_its_own() -> None:
    html = _html(Text("a"))
    assert not re.search(r"""(src|href)=["']?(https?:|//)|@import|url\(""", html)
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    assert policy is not None
    assert policy[1].startswith("default-src 'none';") and "script-src 'sha256-" in policy[1]
    assert "unsafe-inline" not in policy[1].split("script-src")[1]


def test_numbers_stand_right_and_are_shaded_by_their_share() -> None:
    grid = Grid(
        "t",
        ["name", "mm", "n", "word"],
        [["a", "2.0 (1 to 3)", "400", "x"], ["b", "–", "7", "y"], ["c", "1.0", "9", "z"]],
    )
    html = _html(Table(grid, shaded=range(1, 2)))
    assert '<td class="number" style="--share: 1.000">2.0 (1 to 3)</td>' in html
    assert '<td class="number">–</td>' in html and '<td class="number" style="--share: 0.500">1.0</td>' in html
    assert '<td class="number">400</td>' in html and "<td>x</td>" in html and '<th scope="row">a</th>' in html


def test_long_tables_and_too_many_pictures_are_cut_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pages, "MAX_ROWS", 2)
    html = _html(Table(Grid("t", ["a"], [[f"row {k}"] for k in range(5)])))
    assert "row 1" in html and "row 2" not in html and "3 more rows are left out" in html
    monkeypatch.setattr(pages, "MAX_PICTURE_BYTES", 100)
    uri = "data:image/png;base64," + "A" * 38
    assert len(uri) == 60
    html = _html(
        Picture(uri, "first"), Fold("more", [Picture(uri, "second")]), Picture("data:image/png;base64,", "third")
    )
    assert 'alt="first"' in html and 'alt="second"' not in html and 'alt="third"' in html
    assert "Left out, since the pictures of a page are held below 0.0001 MB: second" in html


def test_parts_without_anything_are_named_at_the_end_with_the_reason() -> None:
    def nothing(reason: str) -> Iterator[pages.Block]:
        raise NothingToShow(reason)

    makers = {name: partial(nothing, why) for name, why in {"a": "none.", "b": "gone.", "c": "none."}.items()}
    found = pages.sections([*makers.items(), ("d", lambda: [Text("there")])])
    assert found == [
        Section("d", [Text("there")]),
        Section("Not on this page", [Text("a, c: none."), Text("b: gone.")]),
    ]
    assert pages.sections([("d", lambda: [Text("there")])]) == found[:1]


def test_tables_of_another_version_cost_only_the_parts_that_need_them() -> None:
    table = pa.table({"old": [1]})
    parts = pages.sections([("a", lambda: [Text(str(table["new"]))]), ("d", lambda: [Text("there")])])
    (line,) = parts[-1].blocks
    assert parts[0] == Section("d", [Text("there")]) and isinstance(line, Text)
    assert line.text.startswith("a: its tables are gone or of another version (") and "new" in line.text


def test_columns_of_words_and_numbers_stand_left_and_wide_tables_are_marked() -> None:
    html = _html(Table(Grid("t", ["what", "value"], [["a", "8"], ["b", "eight"]])))
    assert "<td>8</td>" in html and 'class="scroll"' in html
    assert 'class="scroll wide"' in _html(Table(Grid("t", list("abcdefghijkl"), [["1"] * 12])))


def test_what_is_only_for_the_screen_is_not_opened_for_paper() -> None:
    assert "<details><summary>" in _html(Fold("f", []))
    assert '<details class="screen"><summary>' in _html(Fold("f", [], is_printed=False))


def test_code_stands_between_backticks() -> None:
    assert "run <code>a &lt; b</code> again" in _html(Text("run `a < b` again"))
