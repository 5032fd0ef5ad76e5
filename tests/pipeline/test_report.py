import io
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from error_tables import errors_table
from finished_run import CONFIG, write_evaluation, write_rounds
from rich.console import Console

from assemblyhands_core.data.rounds import WindowRule
from pipeline import report
from pipeline.config import RunConfig
from pipeline.dag import build_dag
from pipeline.evaluation import POOLED
from pipeline.report import write_report
from stages.evaluate import UPPER_BOUND

FILES = ["metrics.csv", "pck_curves.png", "error_by_round.png", "crops_by_round.png", "report.html"]


def _report(run: Path, target: str = "evaluate", kinds: dict[str, str] | None = None) -> str:
    """Return what is said when a run's report is written."""
    text = io.StringIO()
    annotating = SimpleNamespace(window_rule=lambda: WindowRule(gamma=1.5, min_joints=11, min_inside=0.5))
    stages = {"evaluate": CONFIG, "annotate_round": annotating}
    dag, rig = build_dag(1), SimpleNamespace(calibration="rig.json")
    config = SimpleNamespace(target=target, stages=stages, rig=rig, dag=dag, wanted_nodes=dag.targets[target])
    write_report(Console(file=text, width=40), cast(RunConfig, config), run, kinds or {})
    return text.getvalue()


def _errors(sequence_id: str, **errors_mm: float) -> pa.Table:
    """Return errors: every joint of 20 frames as far off as its method says."""
    names = {"baseline": "2d_triangulation", "bound": UPPER_BOUND}
    return errors_table(
        {names.get(name, name): np.full((20, 2), value) for name, value in errors_mm.items()}, sequence_id=sequence_id
    )


def _figure(metrics: pd.DataFrame, sequence_id: str, table: str, row: str, metric: str, group: str = "") -> Any:
    wanted = {"sequence_id": sequence_id, "table": table, "row": row, "metric": metric, "group": group}
    (figure,) = [line for line in metrics.to_dict("records") if all(line[name] == wanted[name] for name in wanted)]
    return figure


@dataclass
class Reported:
    """A run of two sequences with all methods, a third that failed in round 1, and a hand that moved; its report."""

    run: Path
    said: str
    figures: dict[str, Any]
    sheets: list[Any]

    @property
    def metrics(self) -> pd.DataFrame:
        return pd.read_csv(self.run / "report" / "metrics.csv").fillna({"group": ""})


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    run = tmp_path_factory.mktemp("run")
    write_evaluation(run, "monday", _errors("monday", baseline=8.0, R1=4.0, R2=2.0, bound=1.0))
    write_evaluation(run, "tuesday", _errors("tuesday", baseline=4.0, R1=2.0, R2=1.0, bound=1.0))
    write_evaluation(run, "failed", _errors("failed", baseline=16.0))
    write_rounds(run, "monday", 0, [(0, 5, 6)])
    figures: dict[str, Any] = {}
    sheets: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        save, draw = report.save_figure, report.draw_sheet
        patch.setattr(
            report, "save_figure", lambda figure, path: figures.update({path.name: figure}) or save(figure, path)
        )
        patch.setattr(report, "draw_sheet", lambda *what: sheets.append(what) or draw(*what))
        return Reported(run, _report(run), figures, sheets)


def test_all_figures_stand_in_one_file(reported: Reported) -> None:
    metrics = reported.metrics
    columns = ["sequence_id", "table", "group", "row", "metric", "value", "low", "high", "n", "coverage"]
    assert list(metrics.columns) == columns and set(metrics["sequence_id"]) == {"monday", "tuesday", "failed", POOLED}
    assert not metrics.duplicated(["sequence_id", "table", "group", "row", "metric"]).any()
    # 20 frames of two hands of 21 joints, all of them equally far off.
    of_one = _figure(metrics, "monday", "annotation", "R1", "mpjpe_mm")
    assert (of_one["value"], of_one["low"], of_one["high"]) == (pytest.approx(4.0),) * 3
    assert (of_one["n"], of_one["coverage"]) == (840, 100.0)
    assert _figure(metrics, "failed", "annotation", "2d_triangulation", "mpjpe_mm")["value"] == pytest.approx(16.0)
    # The mean of 8 and 4 mm; the sequence that lacks rounds is not in it.
    pooled = _figure(metrics, POOLED, "annotation", "2d_triangulation", "mpjpe_mm")
    assert (pooled["value"], pooled["n"]) == (pytest.approx(6.0), 1680) and 4.0 <= pooled["low"] < pooled["high"] <= 8.0
    # Correct from 4 or 2 mm on, and half a step of 0.2 mm before: (16.1 + 18.1) / 2 / 20 mm.
    assert _figure(metrics, POOLED, "annotation", "R1", "pck_auc")["value"] == pytest.approx(85.5)
    by_finger = _figure(metrics, POOLED, "annotation_by_finger", "R2", "mpjpe_mm", "index")
    assert (by_finger["value"], by_finger["n"]) == (pytest.approx(1.5), 2 * 20 * 2 * 4)
    ratio = _figure(metrics, POOLED, "annotation_comparison", "R2 against R1", "mpjpe_mm_ratio")
    assert (ratio["value"], ratio["low"], ratio["high"]) == (pytest.approx(0.5),) * 3
    difference = _figure(metrics, POOLED, "annotation_comparison", "R1 against 2d_triangulation", "mpjpe_mm_difference")
    assert difference["value"] == pytest.approx(-3.0)


def test_it_says_where_the_files_are_each_on_a_line(reported: Reported) -> None:
    folder = reported.run / "report"
    assert reported.said.splitlines() == [f"report: {folder / name}" for name in FILES]
    assert {path.name for path in folder.iterdir()} == set(FILES)
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in FILES if name.endswith("png"))


def test_figures_are_drawn_of_what_was_measured(reported: Reported) -> None:
    curves, rounds = (reported.figures[name] for name in ("pck_curves.png", "error_by_round.png"))
    (axes,) = curves.axes
    lines = {line.get_label().split(":")[0]: line for line in axes.get_lines()}
    assert list(lines) == ["2D + triangulation", "R1", "R2", UPPER_BOUND], "the upper bound is no annotation"
    assert all("synthetic recordings" in text for text in (axes.get_title(), rounds.get_suptitle()))
    # R1: half of the joints are 2 mm off, half 4 mm.
    x, y = lines["R1"].get_data()
    assert [float(y[np.argmin(abs(x - at))]) for at in (1.8, 2.0, 3.8, 4.0, 20.0)] == [0, 50, 50, 100, 100]
    assert lines["R1"].get_label() == "R1: AUC 85.5 %, 100.0 % found"
    assert float(np.trapezoid(y, x) / 20) == pytest.approx(85.5)
    everything, by_finger = rounds.axes
    np.testing.assert_allclose(everything.get_lines()[0].get_xydata(), [[0, 6.0], [1, 3.0], [2, 1.5]])
    labels = [line.get_label() for line in everything.get_lines()]
    assert f"{UPPER_BOUND}: 1.00 mm (100.0 % found, n = 1,680)" in labels
    names = ["thumb", "index", "middle", "ring", "pinky", "wrist"]
    assert [text.get_text() for text in by_finger.get_legend().get_texts()] == names


def test_crops_are_those_of_the_runs_rounds(reported: Reported) -> None:
    (((course,), recordings),) = reported.sheets
    assert recordings == "synthetic recordings" and course.key == ("monday", 0, "right")
    assert [look.caption for look in course.looks] == ["2D + triangulation", "R1: moved 5.0 mm", "R2: moved 1.0 mm"]


def test_what_cannot_be_made_is_left_out_with_a_sentence(tmp_path: Path) -> None:
    write_evaluation(tmp_path, "monday", _errors("monday", baseline=8.0))
    said = _report(tmp_path).splitlines()
    assert said[2:-1] == [
        "report: without error_by_round.png: there are no two rounds to compare",
        "report: without crops_by_round.png: there is no hand with a stored crop that two rounds found",
    ]
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"metrics.csv", "pck_curves.png", "report.html"}
    assert POOLED in (tmp_path / "report" / "metrics.csv").read_text()


def test_where_nothing_was_evaluated_there_is_no_file(tmp_path: Path) -> None:
    said = _report(tmp_path)
    assert said.count("report: without") == 4 and "metrics.csv: nothing was evaluated" in said
    assert [path.name for path in (tmp_path / "report").iterdir()] == ["report.html"], "it says so"


def test_sequences_that_have_no_method_in_common_are_not_pooled(tmp_path: Path) -> None:
    write_evaluation(tmp_path, "monday", _errors("monday", baseline=8.0))
    write_evaluation(tmp_path, "tuesday", _errors("tuesday", R1=8.0))
    assert "without pck_curves.png: no sequence has all methods" in _report(tmp_path)
    assert f"\n{POOLED}," not in (tmp_path / "report" / "metrics.csv").read_text()


def test_only_who_asks_for_an_evaluation_gets_a_report(tmp_path: Path) -> None:
    write_rounds(tmp_path, "monday", 0, [(0, 5, 6)])
    assert _report(tmp_path, target="export") == "" and not (tmp_path / "report").exists()
    said = _report(tmp_path, target="annotate")
    assert said == f"report: {tmp_path / 'report' / 'report.html'}\n", "what is measured without truth stands there"
    assert "crops_by_round.png" in _report(tmp_path) and (tmp_path / "report" / "crops_by_round.png").exists()


def test_rigs_have_figures_of_their_own(tmp_path: Path) -> None:
    write_evaluation(tmp_path, "monday", _errors("monday", baseline=8.0, R1=4.0))
    write_evaluation(tmp_path, "workshop", _errors("workshop", baseline=6.0, R1=5.0))
    said = _report(tmp_path, kinds={"monday": "assembly test", "workshop": "desktop test"})
    for name in ("pck_curves_assembly_test.png", "error_by_round_desktop_test.png"):
        assert (tmp_path / "report" / name).is_file() and name in said
    metrics = pd.read_csv(tmp_path / "report" / "metrics.csv").fillna({"group": ""})
    for pool, value in (("all assembly test", 4.0), ("all desktop test", 5.0)):
        assert _figure(metrics, pool, "annotation", "R1", "mpjpe_mm")["value"] == pytest.approx(value)
