"""The notebooks over a small recording: they run without a warning, and say what the run's tables say."""

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import REPOSITORY, run_record
from notebook_runs import NOTEBOOKS, run_notebook
from tiny_recording import CAMERA_IDS, CHUNK_FRAMES, NUM_FRAMES, detector_overrides

from assemblyhands_core.data.store import load
from assemblyhands_core.hands.joints import HANDS, JOINT_NAMES


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_stored_without_outputs(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert cells[0]["cell_type"] == "markdown" and "".join(cells[0]["source"]).startswith("# ")
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert code and not any(cell["outputs"] or cell["execution_count"] for cell in code)


def test_inspect_annotations_shows_the_run_s_own_figures(judged: Any) -> None:
    environment = {"ASSEMBLYHANDS_WORK": str(judged.workspace), "ASSEMBLYHANDS_RUN": "judged"}
    asked = "[errors_by_method.to_dict(), {str(key): value.to_dict() for key, value in found.items()}, len(worst)]"
    shown = run_notebook("inspect_annotations.ipynb", NOTEBOOKS, environment, asked)
    assert f"run judged, sequence tiny: {len(CAMERA_IDS)} cameras, round_0" in shown.printed
    assert shown.num_pictures == 3
    errors, holes, num_worst = shown.values
    metrics = load(judged.workspace / "runs/judged/evaluation_0", "metrics")
    overall = metrics[(metrics.table == "annotation") & (metrics.metric == "mpjpe_mm")].iloc[0]
    (method,) = errors["MPJPE (mm)"]
    assert method == overall.row == "2d_triangulation"
    assert errors["MPJPE (mm)"][method] == pytest.approx(overall.value, rel=1e-5)
    assert errors["coverage (%)"][method] == pytest.approx(overall.coverage)
    assert errors["joints"][method] == 2 * 21 * NUM_FRAMES and num_worst == 2 * NUM_FRAMES
    joints = load(judged.workspace / "runs/judged/round_0")
    for hand in ("right", "left"):
        own = holes[f"('round_0', '{hand}')"]
        valid = [flag for flags in joints[joints.hand == hand].valid for flag in flags]
        assert own["joints"] == 21 * NUM_FRAMES == len(valid)
        assert own["found (%)"] == pytest.approx(100 * sum(valid) / len(valid))


def test_bring_your_own_rig_goes_from_files_to_pictures(judged: Any, tmp_path: Path) -> None:
    tiny = judged.tiny
    arguments = ["rounds=0", *detector_overrides(tiny.folder), f"ingest.chunk_frames={CHUNK_FRAMES}", "executor=serial"]
    environment = {
        "ASSEMBLYHANDS_WORK": str(tmp_path / "work"),
        "OWN_CALIBRATION": str(tiny.calibration),
        "OWN_VIDEOS": f"{tiny.folder}/videos/*.mp4",
        "OWN_NAME": "monday",
        "OWN_ARGUMENTS": shlex.join(arguments),
    }
    asked = "[sorted(audit.level.unique()), views.valid.to_dict(), int(frame), str(run), len(last)]"
    shown = run_notebook("bring_your_own_rig.ipynb", REPOSITORY, environment, asked)
    levels, is_used, frame, run, num_hands = shown.values
    assert "error" not in levels and is_used == dict.fromkeys(CAMERA_IDS, True)
    assert 0 <= frame < NUM_FRAMES and num_hands == 2 * NUM_FRAMES and shown.num_pictures == 2
    assert Path(run) == tmp_path / "work/runs/own_rig" and "joints in 3D, round_0" in shown.shown
    assert "python -m pipeline doctor" in shown.printed and "python -m pipeline annotate" in shown.printed
    without_truth = {"ASSEMBLYHANDS_WORK": str(tmp_path / "work"), "ASSEMBLYHANDS_RUN": "own_rig"}
    shown = run_notebook("inspect_annotations.ipynb", NOTEBOOKS, without_truth, "[SEQUENCE, methods, len(worst)]")
    assert shown.values == ["monday", [], 0] and "no truth is known" in shown.printed and shown.num_pictures >= 2


def test_correct_labels_moves_one_joint_to_where_a_person_sees_it(judged: Any, tmp_path: Path) -> None:
    environment = {
        "ASSEMBLYHANDS_WORK": str(judged.workspace),
        "ASSEMBLYHANDS_RUN": "judged",
        "CORRECTIONS": str(tmp_path),
        "TRUTH": str(judged.tiny.folder.parent / "truth"),
        "SUSPECTS": "suspects.max_distance_px=0.1",
    }
    asked = "[FRAME, HAND, JOINT, [list(key) for key in changed], after.source[(FRAME, HAND)], len(seen)]"
    shown = run_notebook("correct_labels.ipynb", NOTEBOOKS, environment, asked)
    frame, hand, joint, changed, source, num_seen = shown.values
    assert changed == [[frame, hand]] and source == "manual" and num_seen >= 2 and shown.num_pictures == 2
    num_set = len((tmp_path / "tiny.csv").read_text().splitlines()) - 1  # not where the joint was right already
    assert 2 <= num_set <= num_seen and f"{num_set} points set, of 1 hands" in shown.printed
    assert "task: " in shown.printed
    number = JOINT_NAMES.index(joint)
    joints = load(judged.workspace / "runs/corrected/round_0").set_index(["frame", "hand"]).joints_world_mm
    true = judged.tiny.joints_mm[frame, HANDS.index(hand), number]
    corrected = np.reshape(joints[frame, hand], (21, 3))[number]
    assert np.linalg.norm(corrected - true) < 0.05  # mm; the keypoints' noise is worth some
    others = load(judged.workspace / "runs/judged/round_0").set_index(["frame", "hand"]).joints_world_mm
    same = np.delete(np.reshape(joints[frame, hand], (21, 3)), number, axis=0)
    np.testing.assert_array_equal(same, np.delete(np.reshape(others[frame, hand], (21, 3)), number, axis=0))
    made = run_record(judged.workspace, "corrected")["digests"]
    assert made["detect_keypoints"] == run_record(judged.workspace, "judged")["digests"]["detect_keypoints"]
