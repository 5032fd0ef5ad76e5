"""The whole pipeline over small recordings whose truth is known, by its command line."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Outcome, digests, entries, new_stages, pipeline, run_record
from tiny_recording import CHUNK_FRAMES, NOISE_PX, NUM_FRAMES, write_recording

from assemblyhands_core.data.store import load
from assemblyhands_core.geometry.cameras import Camera
from pipeline.dag import build_dag
from pipeline.graph import CORRECTION_EDGE

NUM_CHUNKS = NUM_FRAMES // CHUNK_FRAMES
NODES = [node.name for node in build_dag(0).upto(("quality", "overlay"), (CORRECTION_EDGE,))]
ONE_SEQUENCE = {
    "ingest": 1, "undistort": 1, "detect_hands": NUM_CHUNKS, "crop_hands": NUM_CHUNKS, "detect_keypoints": NUM_CHUNKS,
    "triangulate": NUM_CHUNKS, "measure_quality": 1, "draw_overlays": 1,
}  # fmt: skip


@dataclass(frozen=True)
class Step:
    """A command that was run in a workspace, and which entries of the store it made, by stage."""

    outcome: Outcome
    workspace: Path
    made: dict[str, int]
    run: str


def step(workspace: Path, *arguments: str, **options: Any) -> Step:
    before = entries(workspace)
    outcome = pipeline(*arguments, workspace=workspace, **options)
    latest = workspace / "runs" / "latest"
    return Step(outcome, workspace, new_stages(workspace, before), latest.resolve().name)


# Each fixture is the next command in the same workspace, so that every run is looked at from several sides.


@pytest.fixture(scope="module")
def first(studio: Any, tmp_path_factory: pytest.TempPathFactory) -> Step:
    workspace = tmp_path_factory.mktemp("first") / "work"
    return step(workspace, "annotate", "executor=serial", *studio.overrides("one.csv"))


@pytest.fixture(scope="module")
def second(studio: Any, first: Step) -> Step:
    environment = {"PYTHONPROFILEIMPORTTIME": "1"}
    return step(first.workspace, "annotate", *studio.overrides("one.csv"), environment=environment)


@pytest.fixture(scope="module")
def plan(studio: Any, second: Step) -> Step:
    return step(second.workspace, "plan", "triangulate.max_reprojection_px=15", *studio.overrides("one.csv"))


@pytest.fixture(scope="module")
def sweep(studio: Any, plan: Step) -> Step:
    values = ["triangulate.max_reprojection_px=20,0.5", "triangulate.min_confidence=0.2"]
    return step(plan.workspace, "annotate", "executor=serial", *studio.overrides("one.csv"), "-m", *values)


@pytest.fixture(scope="module")
def extended(studio: Any, sweep: Step) -> Step:
    return step(sweep.workspace, "executor=serial", *studio.overrides("all.csv"))


@pytest.fixture(scope="module")
def with_one_worker(studio: Any, tmp_path_factory: pytest.TempPathFactory) -> Step:
    """Another workspace, and the sequence as a rig of one's own instead of a manifest's."""
    workspace = tmp_path_factory.mktemp("one") / "work"
    return step(workspace, "annotate", "executor.num_workers=1", *studio.tiny.overrides())


@pytest.fixture(scope="module")
def with_two_workers(studio: Any, tmp_path_factory: pytest.TempPathFactory) -> Step:
    """Another workspace, and the recording moved to a folder whose name needs care."""
    workspace = tmp_path_factory.mktemp("two") / "work"
    moved = write_recording(workspace.parent / "it's my rig, (copy) {1}")
    return step(workspace, "annotate", "executor.num_workers=2", *moved.overrides())


def test_joints_are_where_they_were(studio: Any, first: Step) -> None:
    first.outcome.assert_done()
    table = load(first.workspace / "runs" / "latest" / "round_0")
    found_mm = np.stack(table.joints_world_mm.tolist()).reshape(NUM_FRAMES, 2, 21, 3).astype(np.float64)
    assert table.hand.tolist() == ["right", "left"] * NUM_FRAMES
    assert (
        np.stack(table.valid.tolist()).all() and (np.stack(table.num_views.tolist()) == len(studio.tiny.cameras)).all()
    )
    # Least squares over all views errs by the inverse of the sum of JᵀJ / σ²: measured with it, each joint's squared
    # error is chi-squared with 3 degrees of freedom, of mean 3 and variance 6. More says that the solver is not
    # optimal, less that the error is not that of the noise.
    error_mm = found_mm - studio.tiny.joints_mm
    information = sum(_information(camera, studio.tiny.joints_mm) for camera in studio.tiny.cameras.values())
    squared = np.einsum("...i,...ij,...j->...", error_mm, information, error_mm)
    assert abs(squared.mean() - 3.0) < 4 * np.sqrt(6.0 / squared.size)
    assert squared.max() < 30.0  # of a thousand such numbers, one in a thousand sets has a larger one


def _information(camera: Camera, points_mm: np.ndarray) -> np.ndarray:
    step_mm = 1e-3 * np.eye(3)
    columns = [(camera.project(points_mm + d) - camera.project(points_mm - d)) / 2e-3 for d in step_mm]
    jacobian = np.stack(columns, axis=-1)
    return np.asarray(np.swapaxes(jacobian, -1, -2) @ jacobian / NOISE_PX**2)


def test_everything_is_made_once(first: Step) -> None:
    assert first.made == ONE_SEQUENCE


def test_contents_do_not_depend_on_executor_workers_or_place(
    first: Step, with_one_worker: Step, with_two_workers: Step
) -> None:
    expected = digests(first.workspace, first.run)
    assert list(expected) == NODES and len(set(expected.values())) == len(NODES)
    for other in (with_one_worker, with_two_workers):
        other.outcome.assert_done()
        assert digests(other.workspace) == expected
        assert other.made == ONE_SEQUENCE


def test_a_second_run_makes_nothing_and_no_cluster(first: Step, second: Step) -> None:
    assert second.outcome.code == 0 and second.made == {}
    assert second.run != first.run
    assert digests(second.workspace, second.run) == digests(first.workspace, first.run)
    imported = {line.split("|")[-1].strip() for line in second.outcome.err.splitlines()}
    assert "pipeline.executors" in imported
    assert not {"distributed", "dask", "mediapipe", "torch"} & imported


def test_plan_names_the_parameter_and_what_runs(plan: Step) -> None:
    plan.outcome.assert_done()
    assert plan.made == {}
    lines = {cells[1]: cells for line in plan.outcome.out.splitlines() if len(cells := _cells(line)) > 4}
    assert [node for node, cells in lines.items() if cells[3] == str(NUM_CHUNKS)] == ["round_0"]
    assert lines["round_0"][2:5] == ["0", str(NUM_CHUNKS), "max_reprojection_px 20.0 → 15.0"]
    assert lines["quality"][2:5] == ["0", "1", "round_0 runs first"]
    assert lines["detect_keypoints"][2:5] == [str(NUM_CHUNKS), "0", ""]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("│")[1:-1]]


def test_a_sweep_shares_work_and_stops_where_nothing_changes(first: Step, sweep: Step) -> None:
    sweep.outcome.assert_done()
    # No keypoint has less confidence than 0.2: with 20 px, round 0 comes out as before, and what follows is reused.
    assert sweep.made == {"triangulate": 2 * NUM_CHUNKS, "measure_quality": 1, "draw_overlays": 1}
    runs = [json.loads(path.read_text()) for path in (sweep.workspace / "runs").glob("[!l]*/run.json")]
    parameters = [run["config"]["stages"]["triangulate"] for run in runs]
    found = {
        (p["max_reprojection_px"], p["min_confidence"]): run["digests"] for p, run in zip(parameters, runs, strict=True)
    }
    assert sorted(found) == [(0.5, 0.2), (20.0, 0.1), (20.0, 0.2)]
    assert found[20.0, 0.1] == found[20.0, 0.2]
    changed = {node for node in NODES if found[20.0, 0.1][node] != found[0.5, 0.2][node]}
    assert changed == {"round_0", "quality", "overlay"}


def test_only_a_new_sequence_is_computed(extended: Step) -> None:
    assert extended.made == ONE_SEQUENCE
    table = load(extended.workspace / "runs" / "latest" / "round_0")
    assert table.sequence_id.value_counts().to_dict() == {"tiny": 2 * NUM_FRAMES, "other": 2 * NUM_FRAMES}


def test_a_sequence_that_fails_is_named_and_the_others_are_done(studio: Any, extended: Step) -> None:
    extended.outcome.assert_refused(1, "broken", "calibration.json", "front", "fx", "not finished")
    failures = run_record(extended.workspace)["failures"]
    assert {failure["shard"].split(".")[0] for failure in failures} == {"broken"}
    assert [failure["node"] for failure in failures if failure["status"] == "failed"] == ["ingest"]
    assert {failure["node"] for failure in failures if failure["status"] == "blocked"} == set(NODES) - {"ingest"}
    assert str(studio.broken.calibration) in failures[0]["error"]


def test_the_view_is_whole_and_readable(first: Step) -> None:
    run = first.workspace / "runs" / first.run
    assert sorted(path.name for path in run.iterdir()) == sorted([*NODES, "report", "run.json"])
    for node in NODES:
        manifest = json.loads((run / node / "manifest.json").read_text())
        for table in manifest["tables"]:
            files = {path.stem: path for path in (run / node / table).iterdir()}
            assert set(files) == set(manifest["shards"])
            assert all(path.is_symlink() and not path.readlink().is_absolute() for path in files.values())
            assert all(path.resolve(strict=True).parents[2] == first.workspace / "store" for path in files.values())
    record = run_record(first.workspace, first.run)
    assert record["command"].startswith("python -m pipeline annotate executor=serial rounds=0 manifest=")
    assert record["failures"] == [] and record["config"]["target"] == "annotate"


def test_a_workspace_may_be_moved(first: Step, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    shutil.copytree(first.workspace, moved, symlinks=True)
    assert load(moved / "runs" / first.run / "round_0").equals(load(first.workspace / "runs" / first.run / "round_0"))


def test_load_takes_a_node_a_folder_or_a_file(first: Step, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ASSEMBLYHANDS_WORK", str(first.workspace))
    by_node = load("round_0", run=first.run)
    run = first.workspace / "runs" / first.run
    assert by_node.equals(load(run / "round_0" / "joints"))
    file = run / "round_0" / "joints" / "tiny.00001.parquet"
    assert load(file).frame.tolist() == by_node.frame[2 * CHUNK_FRAMES : 4 * CHUNK_FRAMES].tolist()
    assert load("round_0", "residuals", run=first.run).is_inlier.map(len).eq(21).all()
    overlays = load("overlay", run=first.run)
    assert all(Path(path).is_file() for path in overlays.overlay_file)
    with pytest.raises(FileNotFoundError, match=r"round_9 holds no table; beside it there are: .*round_0"):
        load("round_9", run=first.run)


def test_gc_removes_what_no_kept_run_refers_to(studio: Any, extended: Step) -> None:
    command, workspace = studio.overrides("all.csv"), extended.workspace
    before = entries(workspace)
    would = pipeline("gc", "gc.keep_runs=1", "gc.dry_run=true", workspace=workspace).assert_done()
    assert "would remove 4 runs" in would.said and entries(workspace) == before
    did = pipeline("gc", "gc.keep_runs=1", workspace=workspace).assert_done()
    assert did.said.removeprefix("removed") == would.said.removeprefix("would remove")
    gone = [path.parts[0] for path in set(before) - set(entries(workspace))]
    assert {stage: gone.count(stage) for stage in gone} == {
        "triangulate": 2 * NUM_CHUNKS, "measure_quality": 1, "draw_overlays": 1,
    }  # fmt: skip
    again = step(workspace, "executor=serial", *command)
    assert again.outcome.code == 1 and again.made == {}


def test_a_sweep_over_rounds_makes_each_round_once(studio: Any, extended: Step) -> None:
    swept = step(extended.workspace, "annotate", "executor=serial", *studio.overrides("one.csv", "1,2"), "-m")
    swept.outcome.assert_done()
    assert swept.made == {"annotate_round": 2 * NUM_CHUNKS, "measure_quality": 2, "draw_overlays": 2}
    assert "tiny, round_2: " in swept.outcome.said
    table = max((extended.workspace / "sweeps").glob("*/sweep.csv"))
    rows = [line.split(",") for line in table.read_text().splitlines()[1:]]
    assert {row[0] for row in rows} == {"1", "2"} and "valid joints (%)" in {row[2] for row in rows}
