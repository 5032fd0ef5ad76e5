"""Predictions in egocentric crops: lifted to where they project from, merged over cameras, holes with their reasons."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch
from ego_crops import CAMERA, ego_crops

from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.training_tables import WEIGHTS
from assemblyhands_core.hands.joints import HANDS, WRIST
from assemblyhands_core.hands.kinematics import HandSkeleton, bone_lengths_mm
from assemblyhands_core.models.pretrained import save_weights
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
from stages._contract import Context, Tables
from stages.predict_ego import STAGE, PredictEgoConfig

CONFIG = PredictEgoConfig(decoding="soft_argmax", batch_size=3, wrist_depth="label", min_confidence=0.0)
TINY = SVEgoNetConfig("mobilenetv3_small_050", 2, 8, image_size_px=64, num_depths=8)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    """Of a network that was never trained, but whose heatmaps have peaks."""
    torch.manual_seed(0)
    network, path = SVEgoNet(TINY).eval(), tmp_path_factory.mktemp("net") / "net.safetensors"
    with torch.no_grad():
        network.head[-1].weight.mul_(300.0)
    save_weights(path, network, {})
    return WEIGHTS.from_rows(
        [{"sequence_id": "s", "network": "SVEgoNet", "weights_file": str(path), "sha256": "", "card": "{}"}]
    )


def _run(crops: pa.Table, weights: pa.Table, num_threads: int = 1, **changes: Any) -> Tables:
    config = CONFIG.model_copy(update=changes)
    return STAGE.run(config, {"crops": crops, "weights": weights}, Context(Path(), "s", num_threads))


def _points(row: dict[str, Any], name: str) -> np.ndarray:
    return np.reshape(row[name], (21, -1))


def test_joints_project_to_where_the_network_saw_them_around_the_labelled_wrist(weights: pa.Table) -> None:
    crops = ego_crops(6)
    rows = _run(crops, weights)["hands"].to_pylist()
    assert [row["frame"] for row in rows] == list(range(6)) and [row["valid"] for row in rows].count(False) == 1
    assert rows[3]["reason"] == "near_border" and np.isnan(rows[3]["joints_px"]).all()
    labels = {row["frame"]: np.reshape(row["joints_camera_mm"], (2, 21, 3)) for row in crops.to_pylist()}
    for row in (row for row in rows if row["valid"]):
        points = _points(row, "joints_camera_mm")
        np.testing.assert_allclose(CAMERA.project(points), _points(row, "joints_px"), rtol=0, atol=0.02)
        wrist = labels[row["frame"]][HANDS.index(row["hand"]), WRIST, 2]
        assert row["wrist_depth_mm"] == pytest.approx(wrist, abs=1e-3) and row["wrist_depth_source"] == "label"
        np.testing.assert_allclose(points[:, 2] - wrist, row["depth_mm"], rtol=0, atol=1e-2)
        np.testing.assert_allclose(_points(row, "joints_world_mm"), points, atol=1e-3)  # this camera is the world's
        assert sum(row["identity_probability"]) == pytest.approx(1.0, abs=1e-5)
    assert np.std([row["joints_px"][0] for row in rows if row["valid"]]) > 0.1


def test_without_labels_the_hand_gets_a_mean_hands_size(weights: pa.Table) -> None:
    rows = _run(ego_crops(3), weights, wrist_depth="hand_size")["hands"].to_pylist()
    size_mm = HandSkeleton.average().bone_lengths_mm.sum()
    for row in rows:
        assert row["wrist_depth_source"] == "hand_size"
        found_mm = bone_lengths_mm(_points(row, "joints_camera_mm")).sum()
        assert found_mm == pytest.approx(size_mm, rel=1e-3) or row["wrist_depth_mm"] == pytest.approx(50.0, rel=1e-3)


def test_cameras_are_merged_by_confidence(weights: pa.Table) -> None:
    crops = ego_crops(1)
    moved = np.eye(4)
    moved[:3, 3] = [30.0, 0.0, 10.0]
    rows = crops.to_pylist()
    rows.append({**rows[0], "camera_id": "HMC_other", "T_camera_from_world": moved.ravel()})
    rows.append({**ego_crops(4).to_pylist()[3], "frame": 0, "hand": "right", "camera_id": "HMC_third"})
    made = _run(EGO_CROPS.from_rows(rows), weights)
    hands, (joint,) = made["hands"].to_pylist(), made["joints"].to_pylist()
    seen = [row for row in hands if row["valid"]]
    assert len(hands) == 3 and len(seen) == 2 and set(joint["num_views"]) == {2} and joint["source"] == "svegonet"
    first, second = (_points(row, "joints_world_mm") for row in seen)
    np.testing.assert_allclose(np.abs(first - second), np.tile([30.0, 0.0, 10.0], (21, 1)), atol=1e-2)
    np.testing.assert_allclose(_points(joint, "joints_world_mm"), (first + second) / 2, atol=1e-2)  # equally sure


def test_threads_and_batches_do_not_matter(weights: pa.Table) -> None:
    crops = ego_crops(8)
    one = _run(crops, weights)["hands"]
    assert str(one.to_pylist()) == str(_run(crops, weights, num_threads=3)["hands"].to_pylist())  # NaN is not itself
    alone = _run(crops, weights, batch_size=1)["hands"]
    for name in ("joints_px", "depth_mm"):
        np.testing.assert_allclose(np.stack(one[name].to_pylist()), np.stack(alone[name].to_pylist()), atol=1e-3)


def test_an_unsure_crop_shows_no_hand_and_none_give_empty_tables(weights: pa.Table) -> None:
    made = _run(ego_crops(2), weights, min_confidence=1.0)
    assert {row["reason"] for row in made["hands"].to_pylist()} == {"low_confidence"}
    assert not any(flag for row in made["joints"].to_pylist() for flag in row["valid"])
    assert _run(EGO_CROPS.empty(), weights)["joints"].num_rows == 0
