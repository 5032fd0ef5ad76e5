"""Made-up runs for reports, with names that would do harm if anything were not escaped."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
from error_tables import ego_errors_table, errors_table
from finished_run import (
    CAMERA,
    CONFIG,
    write_ego_table,
    write_errors,
    write_keypoints,
    write_rounds,
    write_verb_table,
)

from assemblyhands_core.data.video import VideoWriter
from pipeline.config import GcConfig, RigConfig, RunConfig
from pipeline.dag import build_dag
from pipeline.executor_config import LocalConfig
from pipeline.finished import FinishedRun, open_run
from stages import annotate_round, tabulate_ego, tabulate_verbs

HOSTILE = "<script>hostile=1<"
"""Name of a sequence."""
ERRORS_MM = {"2d_triangulation": 8.0, "R1": 4.0, "R2": 2.0}
_ROUND = annotate_round.AnnotateRoundConfig.model_construct(
    gamma=1.5, min_box_joints=11, min_inside=0.5, min_keypoint_confidence=0.1
)
_EGO = tabulate_ego.TabulateEgoConfig(block_frames=2, num_resamples=100, seed=0)
_VERBS = tabulate_verbs.TabulateVerbsConfig(
    verbs=("pick up", "screw"), blocks="recording", num_resamples=100, num_bins=5, seed=0
)


def run_config(workspace: Path) -> RunConfig:
    """Return today's configuration, as far as reports need it."""
    config = RunConfig(
        seq="all", target="evaluate", manifest=None, release=None, workspace=workspace, run="", rounds=2,
        gc=GcConfig(keep_runs=10, dry_run=False), rig=RigConfig(calibration="rig.json", videos="*.mp4"),
        executor=LocalConfig(name="serial", num_workers=1, memory_limit="auto"),
    )  # fmt: skip
    config._dag = build_dag(2)
    config._stages = {"evaluate": CONFIG, "annotate_round": _ROUND, "tabulate_ego": _EGO, "tabulate_verbs": _VERBS}
    return config


def write_run(
    workspace: Path, name: str, worse_by: float = 1.0, sequences: tuple[str, ...] = (HOSTILE, "tuesday")
) -> Path:
    """Write an evaluated run: 20 frames of each sequence, errors a multiple of `ERRORS_MM`, and a hand that moved."""
    run, video = workspace / "runs" / name, workspace / "front.mp4"
    _write_video(video)
    noise = np.random.default_rng(0).uniform(0.8, 1.2, (20, 2))
    for sequence in sequences:
        factor = {method: 1.0 if method == "2d_triangulation" else worse_by for method in ERRORS_MM}
        errors = {method: mm * factor[method] * noise for method, mm in ERRORS_MM.items()}
        write_errors(run, sequence, errors_table(errors, sequence_id=sequence, verbs=("screw", "<i>put</i>")))
        write_rounds(run, sequence, 0, [(0, 5, 6)] * 20)
        write_keypoints(run, sequence, 0, 20, str(video))
        for node in ("round_0", "round_1", "round_2"):
            _write_manifest(run / node, sequence)
    (run / "evaluation_0").mkdir(parents=True, exist_ok=True)
    (run / "evaluation_0" / "manifest.json").write_text(json.dumps({"stage": "evaluate", "shards": {}}))
    failure = {"node": "quality", "shard": "x", "status": "failed", "error": "<img src=x onerror=hostile()>"}
    record = {
        "command": "python -m pipeline evaluate seq='<b>'",
        "time": "now",
        "commit": "abc",
        "versions": {"numpy": "2"},
        "config": {
            "seq": "all",
            "rounds": 2,
            "stages": {"evaluate": {"block_frames": 2, "of_another_version": worse_by}},
        },
        "digests": {"round_0": "0d", "round_1": "1d"},
        "failures": [failure],
    }
    (run / "run.json").write_text(json.dumps(record))
    return run


def write_networks(run: Path) -> None:
    """Add tables of networks: an egocentric one on our labels, and verbs by the shipped classifier."""
    write_ego_table(run, "ego_evaluation_automatic", ego_errors_table())
    write_verb_table(run, "verb_table")


def finished(workspace: Path, name: str) -> FinishedRun:
    """Return a run of a workspace."""
    return open_run(run_config(workspace), name)


def _write_video(path: Path) -> None:
    """Write a grey video."""
    with VideoWriter(path, CAMERA.width_px, CAMERA.height_px, Fraction(30)) as video:
        for _ in range(20):
            video.write(np.full((CAMERA.height_px, CAMERA.width_px, 3), 90, np.uint8))


def _write_manifest(node: Path, sequence: str) -> None:
    path = node / "manifest.json"
    manifest = json.loads(path.read_text()) if path.exists() else {"stage": "s", "shards": {}}
    reasons = {"": 40, "too_few_views": 2}
    manifest["shards"][f"{sequence}.00000"] = {
        "key": "k" * 64,
        "seconds": 2.0,
        "outputs": {"joints": {"reasons": reasons}},
    }
    path.write_text(json.dumps(manifest))
