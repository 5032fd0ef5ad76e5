"""What a run prints about verbs, from predictions that can be counted by hand."""

import csv
import io
from pathlib import Path

import numpy as np
import yaml
from finished_run import write_table, write_verb_table
from html_runs import finished, write_run
from rich.console import Console

from assemblyhands_core.data.camera_rows import camera_to_row
from assemblyhands_core.data.catalog import JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.fine_grained import Action, Segment, write_fine_grained_60fps
from assemblyhands_core.data.verb_tables import VERB_PROBLEMS
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from pipeline.html_report.networks import verbs
from pipeline.html_report.page import Fold, Table, Text
from pipeline.set_tables import figure_with_interval
from pipeline.verb_evaluation import print_verbs
from stages._contract import Context
from stages.cut_verb_clips import STAGE as CUT_VERB_CLIPS
from stages.cut_verb_clips import CutVerbClipsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "cut_verb_clips.yaml"
CAMERA = Camera("C1_rgb", 64, 48, 50.0, 50.0, 31.5, 23.5, Pinhole(), np.eye(4))


def _printed(run: Path) -> str:
    said = io.StringIO()
    print_verbs(Console(file=said, width=240), run)
    return said.getvalue()


def test_sources_stand_below_one_another_with_accuracy_and_pose_error(tmp_path: Path) -> None:
    write_verb_table(tmp_path, "verb_table")
    lines = {line.split("│")[1].strip(): line for line in _printed(tmp_path).splitlines() if "│" in line}
    cells = {name: [cell.strip() for cell in line.split("│")[2:-1]] for name, line in lines.items()}
    assert cells["annotation"] == ["100", "50", "75.0", "75.0", "–", "7.0", "100.0", "4"]
    assert cells["svegonet"] == ["50", "50", "50.0", "50.0", "66.7", "7.0", "100.0", "4"]
    assert cells["chance: uniform"][2:4] == ["50.0", "50.0"]
    with (tmp_path / "report" / "verbs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["classifier"] for row in rows} == {"shipped network, our annotation"}


def test_each_kind_of_network_and_labels_has_its_own_table_and_without_any_nothing_is_said(tmp_path: Path) -> None:
    assert _printed(tmp_path) == "" and not (tmp_path / "report").exists()
    write_verb_table(tmp_path, "verb_table_manual")
    write_verb_table(tmp_path, "own_verb_table")
    said = _printed(tmp_path)
    assert said.index("shipped network, people's labels") < said.index("trained on each source, our annotation")


def test_figures_have_an_interval_where_there_is_one() -> None:
    assert figure_with_interval({"value": 1.234, "low": 1.0, "high": 2.0}) == "1.23 (1.00 to 2.00)"
    assert figure_with_interval({"value": 1.26, "low": np.nan, "high": np.nan}, 1) == "1.3"
    assert figure_with_interval(None) == figure_with_interval({"value": np.nan, "low": 0.0, "high": 0.0}) == "–"


def _cut(run: Path, csv_file: Path, sequence_id: str, node: str = "clips_annotation") -> None:
    """Leave what this node says of a recording of 60 frames at 30 Hz in which nobody saw a hand."""
    config = CutVerbClipsConfig.model_validate(yaml.safe_load(CONF.read_text()), strict=False)
    name = {"sequence_id": sequence_id}
    view = {"camera_id": "C1_rgb", "video_file": "", "video_sha256": "", "num_frames": 60, "rate_hz": 30.0}
    view |= {"image_fit": "same", "note": "", **camera_to_row(CAMERA), "valid": True, "reason": ""}
    source = {"role": "actions", "name": "fine_grained", "source_file": str(csv_file), "sha256": ""}
    inputs = {"actions": SOURCES.from_rows([name | source]), "views": VIEWS.from_rows([name | view])}
    made = CUT_VERB_CLIPS.run(config, inputs | {"joints": JOINTS.empty()}, Context(Path(), sequence_id))
    write_table(run / node / "problems" / f"{sequence_id}.parquet", VERB_PROBLEMS, made["problems"])


def _shared_file(path: Path, num_unreadable: int) -> None:
    """Write a file of two recordings: of "a" a screw and a clap, of "b" a screw after the end, and bad rows."""
    labels = (("a", 0, "screw"), ("a", 70, "clap"), ("b", 300, "screw"))
    segments = [
        Segment(recording, start, start + 19, 60, Action.of(verb, "bolt", ("bolt",)))
        for recording, start, verb in labels
    ]
    write_fine_grained_60fps(path, segments)
    good = path.read_text().splitlines()
    path.write_text("\n".join([*good, *[good[1].replace("000000019", "x")] * num_unreadable]) + "\n")


def test_odd_labels_are_said_once_for_a_file_that_recordings_share(tmp_path: Path) -> None:
    run, csv_file = write_run(tmp_path, "made_up"), tmp_path / "train.csv"
    _shared_file(csv_file, 2)
    for name in ("a", "b"):
        _cut(run, csv_file, name)
        _cut(run, csv_file, name, "clips_svegonet")  # the same segments with other poses
    counts = (
        "action labels, clips_annotation: left out: unreadable 2, other verb 1, beyond video 1; "
        "kept, though odd: no poses 1"
    )
    bad = "its end_frame is 'x' instead of a whole number; the row is left out."
    sentences = [
        f"{csv_file}, line 5: {bad}",
        f"{csv_file}, line 6: {bad}",
        "b: 'screw' at 60 Hz frames 300 to 319 lies outside the recording's frames 0 to 119; it is left out.",
    ]
    assert _printed(run).splitlines() == [counts, *(f"  {sentence}" for sentence in sentences)]
    write_verb_table(run, "verb_table")
    *_, line, fold = verbs(finished(tmp_path, "made_up"))
    assert isinstance(line, Text) and line.text == f"{counts}."
    assert isinstance(fold, Fold) and isinstance(fold.blocks[0], Table)
    assert fold.blocks[0].grid.rows == [[sentence] for sentence in sentences]


def test_the_terminal_names_some_odd_labels_and_says_where_the_others_are(tmp_path: Path) -> None:
    csv_file = tmp_path / "train.csv"
    _shared_file(csv_file, 12)
    _cut(tmp_path, csv_file, "a")
    lines = _printed(tmp_path).splitlines()
    assert len(lines) == 1 + 10 + 1 and "unreadable 12" in lines[0]
    assert lines[-1].startswith("  2 more of them: the column sentence of ") and "clips_annotation" in lines[-1]


def test_labels_that_were_all_used_are_not_worth_a_line(tmp_path: Path) -> None:
    name = {"sequence_id": "a", "sentence": "", "reason": "other_recording", "count": 9}
    write_table(tmp_path / "clips_annotation/problems/a.parquet", VERB_PROBLEMS, VERB_PROBLEMS.from_rows([name]))
    assert _printed(tmp_path) == ""
