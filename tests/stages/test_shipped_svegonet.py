"""The shipped SVEgoNet, on hands of two persons that no network has seen: better than chance by far, no miracle."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import yaml

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.data.training_tables import WEIGHTS
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.infer import SHIPPED, HandPredictor
from stages import draw_ego_crops, evaluate_ego, predict_ego
from stages._contract import Context, StageConfig

CONF = Path(__file__).parents[2] / "conf" / "stage"
ORDERS = CROP_ORDERS.from_rows([{"sequence_id": "e", "split": "test", "rig": "assembly", "duration_s": 24.0}])


@pytest.fixture(scope="module")
def crops() -> pa.Table:
    tables = []
    for take in (0, 1):
        chunk = CHUNKS.from_rows([{"sequence_id": "e", "chunk": take, "first_frame": 8 * take, "num_frames": 5}])
        config = draw_ego_crops.DrawEgoCropsConfig(**yaml.safe_load((CONF / "draw_ego_crops.yaml").read_text()))
        tables.append(draw_ego_crops.run(config, {"orders": ORDERS, "chunks": chunk}, Context(Path(), "e"))["crops"])
    table = pa.concat_tables(tables)
    return table.filter(table["valid"])


def test_it_finds_the_joints_and_whose_they_are(crops: pa.Table) -> None:
    weights = {"sequence_id": "e", "network": "SVEgoNet", "weights_file": str(SHIPPED), "sha256": "", "card": "{}"}
    config = predict_ego.PredictEgoConfig(**yaml.safe_load((CONF / "predict_ego.yaml").read_text()))
    context = Context(Path(), "e")
    hands = predict_ego.run(config, {"crops": crops, "weights": WEIGHTS.from_rows([weights])}, context)["hands"]
    errors = evaluate_ego.run(StageConfig(), {"crops": crops, "hands": hands}, context)["errors"]
    error_mm = to_numpy(errors["error_mm"]).reshape(-1, 21)
    assert len(error_mm) >= 20 and np.isfinite(error_mm).mean() > 0.9
    assert 3.0 < np.nanmean(error_mm) < 25.0
    assert to_numpy(errors["is_identity_right"]).mean() > 0.8


def test_the_few_lines_api_agrees_with_the_labels(crops: pa.Table) -> None:
    predictor, errors = HandPredictor(), []
    for row in crops.slice(0, 8).to_pylist():
        image, camera = decode_image(row["image"]), camera_from_row(row)
        own = HANDS.index(row["hand"])
        true = np.reshape(row["joints_camera_mm"], (2, 21, 3))[own]
        pixels = np.reshape(row["joints_px"], (2, 21, 2))[own]
        box = (*pixels.min(axis=0), *pixels.max(axis=0))
        found = predictor.predict(image, camera, box, row["hand"], wrist_depth_mm=float(true[20, 2]))
        errors.append(np.linalg.norm((found.joints_camera_mm - found.joints_camera_mm[20]) - (true - true[20]), axis=1))
    assert 3.0 < np.mean(errors) < 30.0
