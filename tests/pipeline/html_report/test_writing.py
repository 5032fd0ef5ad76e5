"""The page of a made-up run, by what stands in it."""

import html
import io
import re
from pathlib import Path

import pytest
from html_runs import HOSTILE, finished, write_run
from rich.console import Console

from pipeline.html_report.page import Fold, Page, Section, Table, Text
from pipeline.html_report.writing import run_page, write_page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    workspace = tmp_path_factory.mktemp("work")
    write_run(workspace, "made_up")
    return run_page(finished(workspace, "made_up"))


def _section(page: Page, title: str) -> Section:
    (section,) = [section for section in page.sections if section.title == title]
    return section


def _tables(section: Section) -> list[Table]:
    blocks = [inner for block in section.blocks for inner in (block.blocks if isinstance(block, Fold) else [block])]
    return [block for block in blocks if isinstance(block, Table)]


def _rows(table: Table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.grid.columns, row, strict=True)) for row in table.grid.rows}


def test_the_summary_begins_with_what_failed_and_coverage(page: Page) -> None:
    section = _section(page, "Summary")
    failed, judged, outcomes, views = _tables(section)
    assert "1 shards were not finished" in section.blocks[0].text  # type: ignore[union-attr]
    assert failed.grid.rows == [["quality", "x", "failed", "<img src=x onerror=hostile()>"]]
    assert judged.grid.columns[1] == "found (%)" and _rows(judged)["R2"]["found (%)"].startswith("100.00")
    # 2 of 42 joints of each sequence are missing, for a reason.
    assert _rows(outcomes)["round_1"] == {
        "node": "round_1", "found (%)": "95.24", "too few views (%)": "4.76", "joints looked for": "84"}  # fmt: skip
    assert _rows(views)["tuesday"]["cameras"] == "<b>dark</b>"
    assert any(isinstance(block, Text) and "not comparable" in block.text for block in section.blocks)


def test_methods_stand_beside_the_papers(page: Page) -> None:
    beside = _rows(_tables(_section(page, "Annotation against the truth"))[0])
    assert beside["2D + triangulation"]["paper (mm)"] == "7.97" and beside["R1"]["paper (%)"] == "79.2"
    assert beside["R2"]["paper (mm)"] == "4.30" and float(beside["R2"]["MPJPE (mm)"].split()[0]) == pytest.approx(
        2, abs=0.1
    )


def test_reprojection_is_by_camera_joint_and_round(page: Page) -> None:
    """Hands are 0, 5 and 6 mm beside the keypoints, 1 px a mm."""
    by_camera, *by_joint = _tables(_section(page, "Reprojection by camera, joint and round"))
    assert by_camera.grid.rows == [["front", "0.00", "5.00", "6.00", str(2 * 20 * 21)]]
    assert [len(table.grid.rows) for table in by_joint] == [21] * 3 and by_joint[1].grid.rows[7] == [
        "index_mcp",
        "5.00",
    ]


def test_displacements_sequences_and_time(page: Page) -> None:
    moved = _rows(_tables(_section(page, "From round to round"))[0])
    assert moved["R0 → R1"]["moved: median (mm)"] == "1.00" and moved["R1 → R2"]["hands"] == "40"
    assert set(_rows(_tables(_section(page, "Sequences"))[0])) == {HOSTILE, "tuesday"}
    times = _rows(_tables(_section(page, "Time"))[0])["round_0"]
    assert (times["all shards (s)"], times["share (%)"]) == ("4.0", "33.3")
    keys = _tables(_section(page, "Provenance"))[-1].grid
    assert ["tuesday.00000", "round_2", "k" * 64] in keys.rows


def test_what_the_run_has_not_is_said(page: Page) -> None:
    for title in ("Overlays", "Egocentric hands", "Verbs", "Quality without truth"):
        (only,) = _section(page, title).blocks
        assert isinstance(only, Text) and only.text.endswith(".") and "run" in only.text


def test_nothing_from_data_reaches_the_page_as_markup(page: Page) -> None:
    written = page.render()
    assert (
        written.count("<script>") == 1 and "<b>" not in written and "<i>" not in written and "<img src=x" not in written
    )
    assert html.escape(HOSTILE) in written and written.count('src="data:image/') >= 4
    assert len(written) < 5_000_000


def test_an_empty_run_has_a_page_of_sentences(tmp_path: Path) -> None:
    (tmp_path / "runs" / "empty").mkdir(parents=True)
    (tmp_path / "runs" / "empty" / "run.json").write_text("{}")
    said = io.StringIO()
    path = write_page(Console(file=said, width=40), finished(tmp_path, "empty"))
    assert said.getvalue() == f"report: {path}\n" and path.name == "report.html"
    written = path.read_text()
    assert "This run annotated nothing." in written and "<table" not in written.split("Provenance</h2>")[0]
    assert len(re.findall(r"<section ", written)) == 13 and "<img" not in written
