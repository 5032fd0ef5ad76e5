"""What a run prints about verbs, from predictions that can be counted by hand."""

import csv
import io
from pathlib import Path

import numpy as np
from finished_run import write_verb_table
from rich.console import Console

from pipeline.set_tables import figure_with_interval
from pipeline.verb_evaluation import print_verbs


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
