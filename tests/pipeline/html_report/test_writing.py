"""The page of a made-up run, by what stands in it."""

import html
import io
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from error_tables import errors_table
from finished_run import write_errors, write_table
from html_runs import HOSTILE, finished, write_networks, write_run
from rich.console import Console

from assemblyhands_core.data.catalog import OVERLAYS
from assemblyhands_core.data.crop_images import encode_jpeg
from pipeline.evaluation import Pool
from pipeline.html_report.annotation import pool_title
from pipeline.html_report.page import Drawings, Fold, Page, Picture, Section, Table, Text
from pipeline.html_report.writing import run_page, write_page


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    workspace = tmp_path_factory.mktemp("work")
    write_networks(write_run(workspace, "made_up"))
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
    synthetic, unfinished = section.blocks[:2]
    assert isinstance(synthetic, Text) and "on synthetic recordings" in synthetic.text
    assert isinstance(unfinished, Text) and "1 shards were not finished" in unfinished.text
    assert failed.grid.rows == [["quality", "x", "failed", "<img src=x onerror=hostile()>"]]
    assert judged.grid.columns[1] == "found (%)" and _rows(judged)["R2"]["found (%)"].startswith("100.00")
    # 2 of 42 joints of each sequence are missing, for a reason.
    assert _rows(outcomes)["round_1"] == {
        "node": "round_1", "found (%)": "95.24", "too few views (%)": "4.76", "joints looked for": "84"}  # fmt: skip
    assert _rows(views)["tuesday"]["cameras"] == "<b>dark</b>"


def test_methods_stand_beside_the_papers(page: Page) -> None:
    beside = _rows(_tables(_section(page, "Annotation against the truth"))[0])
    assert beside["2D + triangulation"]["paper, real data (mm)"] == "7.97"
    assert beside["R1"]["paper, real data (%)"] == "79.2" and float(
        beside["R2"]["MPJPE (mm)"].split()[0]
    ) == pytest.approx(2, abs=0.1)


def test_reprojection_is_by_camera_joint_and_round(page: Page) -> None:
    """Hands are 0, 5 and 6 mm beside the keypoints, 1 px a mm."""
    by_camera, *by_joint = _tables(_section(page, "Reprojection"))
    assert by_camera.grid.rows == [["front", "0.00", "5.00", "6.00", str(2 * 20 * 21)]]
    assert [len(table.grid.rows) for table in by_joint] == [21] * 3 and by_joint[1].grid.rows[7] == [
        "index_mcp",
        "5.00",
    ]


def test_a_group_that_one_method_lacks_has_a_dash_there(tmp_path: Path) -> None:
    """Every other frame is a "pull", which the second method's labels do not know: 10 of 20 frames of 42 joints."""
    run = write_run(tmp_path, "made_up", sequences=())
    first, second = (
        errors_table({method: np.full((20, 2), mm)}, verbs=verbs)
        for method, mm, verbs in (("2d_triangulation", 8.0, ("screw", "pull")), ("R1", 4.0, ("screw",)))
    )
    write_errors(run, "s", pa.concat_tables([first, second]))
    (by_verb,) = [
        table
        for table in _tables(_section(run_page(finished(tmp_path, "made_up")), "Error by joint"))
        if table.grid.title == "MPJPE by verb"
    ]
    assert by_verb.grid.columns[1:3] == ["2D + triangulation (mm)", "R1 (mm)"]
    assert sorted(by_verb.grid.rows) == [
        ["pull", "8.00", "–", "100.0", "420"],
        ["screw", "8.00", "4.00", "100.0", "420"],
    ]


def test_displacements_sequences_and_time(page: Page) -> None:
    moved = _rows(_tables(_section(page, "From round to round"))[0])
    assert moved["R0 → R1"]["moved: median (mm)"] == "1.00" and moved["R1 → R2"]["hands"] == "40"
    assert set(_rows(_tables(_section(page, "Sequences"))[0])) == {HOSTILE, "tuesday"}
    times = _rows(_tables(_section(page, "Time and cost"))[0])["round_0"]
    assert (times["all shards (s)"], times["share (%)"]) == ("4.0", "33.3")
    keys = _tables(_section(page, "Provenance"))[-1].grid
    assert ["tuesday.00000", "round_2", "k" * 64] in keys.rows


def test_networks_stand_beside_the_papers(page: Page) -> None:
    (ego,) = _tables(_section(page, "Egocentric hands"))
    assert [row[:2] for row in ego.grid.rows] == [["Train-A", "Eval-M"]] and ego.grid.rows[0][-1] == "25.18"
    shipped, *confusions, paper = _tables(_section(page, "Verbs"))
    assert _rows(shipped)["svegonet"]["screw"] == "50" and paper.grid.title.startswith("The paper's Table 5")
    told = {table.grid.title.split(":")[0]: _rows(table) for table in confusions}
    assert told["annotation"]["screw"] == {
        "true verb": "screw", "told: pick up": "50", "told: screw": "50 ✓", "segments": "2"}  # fmt: skip
    assert told["svegonet"]["screw"]["told: (none)"] == "50"


def test_the_worst_hands_have_their_crops_and_whole_pictures(page: Page) -> None:
    pictures = [block for block in _section(page, "Worst and random hands").blocks if isinstance(block, Picture)]
    strips = [picture for picture in pictures if picture.caption]
    assert [picture.caption.split(":")[0] for picture in strips] == ["Worst"] * 4 + ["Random"] * 4
    assert all(
        "front" in strip.caption and "mm from the truth: 2D + triangulation" in strip.caption for strip in strips
    )
    wholes = [picture for picture in pictures if not picture.caption]
    assert len(wholes) == 8 and all(picture.alt.startswith("front, frame ") for picture in wholes)


def test_what_the_run_has_not_is_said_at_the_end(page: Page) -> None:
    lines = [block.text for block in page.sections[-1].blocks if isinstance(block, Text)]
    assert page.sections[-1].title == "Not on this page" and lines == [
        "Overlays: this run drew none: `annotate` and `predict` do.",
        "Quality without truth: this run made no quality tables: `annotate` does.",
    ]
    assert not {"Overlays", "Quality without truth"} & {section.title for section in page.sections}


def test_nodes_take_turns_with_their_pictures_and_what_is_not_shown_is_counted(tmp_path: Path) -> None:
    """The headset's sheets, first by name, would fill the page; of a film there is nothing to show."""
    run = write_run(tmp_path, "made_up")
    for node, names in {
        "ego_sheet": [f"sheet_{k}.jpg" for k in range(8)],
        "overlay": ["film.mp4", "a.jpg", "b.jpg"],
    }.items():
        rows = [{"sequence_id": "s", "kind": n, "camera_id": "", "overlay_file": n, "sha256": ""} for n in names]
        write_table(run / node / "overlays" / "s.parquet", OVERLAYS, OVERLAYS.from_rows(rows))
        for name in names:
            (run / node / "overlays" / name).write_bytes(encode_jpeg(np.full((8, 8, 3), 90, np.uint8), 95))
    section = _section(run_page(finished(tmp_path, "made_up")), "Overlays")
    pictures = [block.alt.split()[-1] for block in section.blocks if isinstance(block, Picture)]
    assert pictures == ["sheet_0.jpg", "sheet_1.jpg", "a.jpg", "sheet_2.jpg", "b.jpg", "sheet_3.jpg"]
    lines = [block.text for block in section.blocks if isinstance(block, Text)]
    assert len(lines) == 2 and all("/overlays/*.parquet` lead" in line for line in lines)
    assert lines[0].startswith("ego_sheet: 4 more of 8 ") and lines[1].startswith("overlay: 1 more of 3 ")


def test_nothing_from_data_reaches_the_page_as_markup(page: Page) -> None:
    written = page.render()
    assert (
        written.count("<script>") == 1 and "<b>" not in written and "<i>" not in written and "<img src=x" not in written
    )
    assert html.escape(HOSTILE) in written and written.count('src="data:image/') >= 4
    assert len(written) < 5_000_000


def test_methods_of_no_round_are_shown_as_they_are(tmp_path: Path) -> None:
    """As `ego_only` leaves them: rounds that were not evaluated, and a method beside them that was."""
    run = write_run(tmp_path, "ego")
    for node in run.glob("evaluation_[0-9]"):
        node.rename(node.with_name(node.name.replace("evaluation", "evaluation_ego_only")))
    page = run_page(finished(tmp_path, "ego"))
    (table,) = _tables(_section(page, "Sequences"))
    assert "PCK-AUC (%): R1" in table.grid.columns and len(table.grid.columns) == 2 + 3 * 3
    (drawings,) = [block for block in _section(page, "Error by joint").blocks if isinstance(block, Drawings)]
    assert [caption.split(":")[0] for _, caption in drawings.drawings] == ["2D + triangulation", "R1", "R2"]
    captions = [b.caption for b in _section(page, "Worst and random hands").blocks if isinstance(b, Picture)]
    assert any("px from its 2D keypoints: R2 1.0" in caption for caption in captions)


def test_an_empty_run_has_a_page_of_sentences(tmp_path: Path) -> None:
    (tmp_path / "runs" / "empty").mkdir(parents=True)
    (tmp_path / "runs" / "empty" / "run.json").write_text("{}")
    said = io.StringIO()
    path = write_page(Console(file=said, width=40), finished(tmp_path, "empty"))
    assert said.getvalue() == f"report: {path}\n" and path.name == "report.html"
    written = path.read_text()
    assert "This run annotated nothing." in written and "<table" not in written
    assert re.findall(r"<h2>(.*)</h2>", written) == ["Summary", "Not on this page"] and "<img" not in written
    assert "Annotation against the truth, Error by joint, Sequences: this run was not held against the truth" in written


def test_kinds_of_sequences_are_named_once() -> None:
    tables = [pa.table({})] * 2
    names = ("all", "all desktop desktop", "all, headset alone", "all assembly test, headset alone")
    titles = [pool_title(Pool(name, tables[: 1 + (name == "all")], [])) for name in names]
    assert titles == [
        "all: 2 sequences",
        "desktop: 1 sequence",
        "headset alone: 1 sequence",
        "assembly test, headset alone: 1 sequence",
    ]
