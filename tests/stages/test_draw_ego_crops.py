"""Crops of the headset's pictures, drawn directly: labels lie on the hands, what the rule leaves out is a hole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, WRIST
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.take import Take
from stages._contract import Context
from stages.draw_ego_crops import STAGE, DrawEgoCropsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "draw_ego_crops.yaml"
ORDERS = CROP_ORDERS.from_rows([{"sequence_id": "e", "split": "train", "rig": "assembly", "duration_s": 24.0}])
CHUNK = CHUNKS.from_rows([{"sequence_id": "e", "chunk": 4, "first_frame": 8, "num_frames": 2}])


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    config = DrawEgoCropsConfig(**yaml.safe_load(CONF.read_text()) | {"size_px": 48})
    table = STAGE.run(config, {"orders": ORDERS, "chunks": CHUNK}, Context(Path(), "e"))["crops"]
    EGO_CROPS.check(table)
    return table.to_pylist()


def test_there_is_a_row_for_each_hand_camera_and_instant_and_holes_say_why(rows: list[dict[str, Any]]) -> None:
    assert len(rows) == 2 * 2 * 4 and {row["frame"] for row in rows} == {8, 9}
    assert all((row["reason"] == "") == row["valid"] == (row["image"] != b"") for row in rows)
    assert {row["hand"] for row in rows if row["valid"]} == set(HANDS)


def test_labels_are_the_takes_joints_seen_by_the_crops_camera(rows: list[dict[str, Any]]) -> None:
    drawn = draw_training_take(training_subject("train", 4), 4, num_instants=2)
    take = Take.from_seed(drawn.subject, drawn.take_seed, drawn.duration_s)
    for row in (row for row in rows if row["valid"]):
        joints = take.joints_at(drawn.times_s[row["frame"] - 8])
        camera = camera_from_row(row)
        np.testing.assert_allclose(np.reshape(row["joints_camera_mm"], (42, 3)), camera.to_camera(joints), atol=0.01)
        np.testing.assert_allclose(np.reshape(row["joints_px"], (42, 2)), camera.project(joints), atol=0.01)
        relative = np.reshape(row["joints_wrist_relative_mm"], (2, NUM_JOINTS, 3))
        np.testing.assert_allclose(relative[:, WRIST], 0.0, atol=1e-4)
        own = np.reshape(row["is_labelled"], (2, NUM_JOINTS))[HANDS.index(row["hand"])]
        assert own.sum() >= 15 and row["source"] == "truth"


def test_the_hand_is_brighter_than_what_it_hides_and_pictures_are_grey(rows: list[dict[str, Any]]) -> None:
    for row in (row for row in rows if row["valid"]):
        image = decode_image(row["image"]).astype(float)
        assert image.shape == (48, 48, 3) and np.abs(image - image.mean(axis=2, keepdims=True)).max() < 2
        assert image.std() > 5


def test_the_same_order_gives_the_same_bytes(rows: list[dict[str, Any]]) -> None:
    config = DrawEgoCropsConfig(**yaml.safe_load(CONF.read_text()) | {"size_px": 48})
    again = STAGE.run(config, {"orders": ORDERS, "chunks": CHUNK}, Context(Path(), "e"))["crops"].to_pylist()
    assert [row["image"] for row in again] == [row["image"] for row in rows]
