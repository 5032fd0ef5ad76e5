import csv
import json
from dataclasses import asdict
from pathlib import Path

import hydra
import numpy as np
import pytest
from error_tables import errors_table
from finished_run import write_evaluation, write_table
from rich.console import Console

from assemblyhands_core.data.catalog import BODIES, BODY_KEYPOINTS, JOINTS, RESIDUALS, VIEWS
from assemblyhands_core.data.entry_records import Output, count_reasons
from assemblyhands_core.data.evaluation_tables import QUALITY
from assemblyhands_core.viz.sweep_figure import SweptValue, sweep_figure
from pipeline.config import CONF_FOLDER, RunConfig, check_config
from pipeline.sweeps import Point, varied_parameters, write_sweep
from stages._contract import Context
from stages.measure_quality import STAGE as MEASURE_QUALITY
from stages.measure_quality import MeasureQualityConfig


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RunConfig:
    with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        return check_config(hydra.compose("config", [f"workspace={tmp_path_factory.mktemp('work')}"]))


def _point(config: RunConfig, run: str, *overrides: str) -> Point:
    return Point(overrides, config.model_copy(update={"run": run}))


def _evaluated(point: Point, error_mm: float) -> Point:
    """Leave what a run with two rounds leaves: its last one is off by so much."""
    folder = point.config.workspace / "runs" / point.config.run
    errors = {"2d_triangulation": np.full((24, 2), 9.0), "R1": np.full((24, 2), error_mm)}
    write_evaluation(folder, "s", errors_table(errors))
    (folder / "run.json").write_text(json.dumps({"config": {}, "digests": {}}))
    return point


def _unjudged(point: Point, num_left: int) -> Point:
    """Leave what a run without truth leaves: of 10 frames the left hand is there in so many, the right one in all.

    Its views are off by 1 px in camera a, with 420 inliers, and by 3 px in camera b, with 140.
    """
    folder = point.config.workspace / "runs" / point.config.run
    is_there = np.repeat(np.stack([np.full(10, True), np.arange(10) < num_left], axis=1).reshape(20, 1), 21, axis=1)
    hands = {"sequence_id": ["s"] * 20, "frame": np.repeat(np.arange(10), 2), "hand": ["right", "left"] * 10}
    joints = JOINTS.build(
        hands
        | {"joints_world_mm": np.where(np.repeat(is_there, 3, axis=1), 1.0, np.nan), "valid": is_there}
        | {"reason": np.where(is_there, "", "too_few_views"), "num_views": np.full((20, 21), 2)}
        | {"reprojection_px": np.full((20, 21), 1.0), "source": ["test"] * 20, "round": [0] * 20}
    )
    is_inlier = np.concatenate([np.full((20, 21), True), np.tile(np.arange(21) < 7, (20, 1))])
    columns = {name: np.tile(values, 2) for name, values in hands.items()} | {"camera_id": ["a"] * 20 + ["b"] * 20}
    pixels = {"residual_px": np.repeat([[1.0], [3.0]], 20, axis=0) * np.ones(21), "is_inlier": is_inlier}
    inputs = {"joints": joints, "triangulated": joints, "residuals": RESIDUALS.build(columns | pixels)}
    inputs |= {"views": VIEWS.empty(), "bodies": BODIES.empty(), "body_keypoints": BODY_KEYPOINTS.empty()}
    stage_config = MeasureQualityConfig(num_sync_frames=10, max_shift_frames=1, max_reprojection_px=10.0)
    quality = MEASURE_QUALITY.run(stage_config, inputs, Context(folder, "s"))["quality"]
    write_table(folder / "quality" / "quality" / "s.parquet", QUALITY, quality)
    shards = {f"s.{k:05}": count_reasons(chunk) for k, chunk in enumerate((joints[:8], joints[8:]))}
    outputs = {name: {"outputs": {"joints": asdict(Output("", 1, 1, found))}} for name, found in shards.items()}
    (folder / "round_0").mkdir()
    (folder / "round_0" / "manifest.json").write_text(json.dumps({"shards": outputs}))
    (folder / "run.json").write_text(json.dumps({"config": {}, "digests": {}}))
    return point


def test_what_was_varied_is_told_from_what_all_points_share(config: RunConfig) -> None:
    first = _point(config, "a", "target=evaluate", "rounds=1", "annotate_round.gamma=1.2")
    assert varied_parameters(
        [first, _point(config, "b", "target=evaluate", "rounds=2", "annotate_round.gamma=1.2")]
    ) == ["rounds"]
    assert varied_parameters([first]) == []


def test_a_line_for_each_point_of_its_last_round_and_one_of_a_run_that_failed(
    config: RunConfig, tmp_path: Path
) -> None:
    points = [
        _evaluated(_point(config, "one", "rounds=1"), 4.0),
        _evaluated(_point(config, "two", "rounds=2"), 2.5),
        _point(config, "failed", "rounds=3"),
    ]
    console = Console(record=True, width=200)
    write_sweep(console, points, tmp_path / "sweep")
    said = console.export_text()
    lines = {line.split("│")[1].strip(): line for line in said.splitlines() if line.startswith("│")}
    assert "4.00" in lines["1"] and "2.50" in lines["2"] and "failed" in lines["3"] and "–" in lines["3"]
    with (tmp_path / "sweep" / "sweep.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["figure"] == "MPJPE (mm)"]
    assert [(row["rounds"], row["run"], float(row["value"])) for row in rows] == [("1", "one", 4.0), ("2", "two", 2.5)]
    assert [int(row["n"]) for row in rows] == [24 * 2 * 21] * 2
    assert (tmp_path / "sweep" / "sweep.png").read_bytes()[1:4] == b"PNG"


def test_without_truth_joints_of_both_hands_count_the_same_and_reprojection_is_of_all_joints_once(
    config: RunConfig, tmp_path: Path
) -> None:
    """Of 420 joints, 210 right ones are there and 21 left ones; of the second point's none: no row says so."""
    points = [
        _unjudged(_point(config, "few", "rounds=0", "a.b=1"), 1),
        _unjudged(_point(config, "none", "rounds=0", "a.b=2"), 0),
    ]
    write_sweep(Console(width=200), points, tmp_path)
    with (tmp_path / "sweep.csv").open() as file:
        rows = [(row["run"], row["figure"], float(row["value"]), int(row["n"])) for row in csv.DictReader(file)]
    reprojection = "reprojection of 2D + triangulation, cameras' medians (px)"
    assert rows == [
        ("few", "valid joints (%)", 55.0, 420),
        ("few", reprojection, 1.5, 420 + 140),
        ("none", "valid joints (%)", 50.0, 420),
        ("none", reprojection, 1.5, 420 + 140),
    ]


def test_nothing_is_left_of_a_sweep_over_one_value(config: RunConfig, tmp_path: Path) -> None:
    write_sweep(Console(), [_point(config, "one", "rounds=1")], tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()


def test_numbers_stand_where_they_are_and_the_second_parameter_has_a_line_for_each_value() -> None:
    values = [
        SweptValue((gamma, rounds), float(gamma) + int(rounds), np.nan, np.nan)
        for rounds in ("2", "10")
        for gamma in ("2.0", "1.2", "1.5")
    ]
    (axes,) = sweep_figure(["gamma", "rounds"], "error (mm)", values).axes
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["rounds=2", "rounds=10"]
    lines = [container.lines[0] for container in axes.containers]
    assert [line.get_xdata().tolist() for line in lines] == [[1.2, 1.5, 2.0]] * 2
    np.testing.assert_allclose([line.get_ydata() for line in lines], [[3.2, 3.5, 4.0], [11.2, 11.5, 12.0]])
    (words,) = sweep_figure(["detector"], "error", [SweptValue((n,), 1.0, 0.5, 2.0) for n in ("b", "a")]).axes
    assert [tick.get_text() for tick in words.get_xticklabels()] == ["b", "a"]
    with pytest.raises(ValueError, match="not 3"):
        sweep_figure(["a", "b", "c"], "error", [])
