"""Stages that train, on a dozen hands: they learn, start where they are told, and leave weights that can be read."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest
import torch
import yaml
from pydantic import ValidationError
from spotted_hands import hand_tables

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.training_tables import BODY_LABELS, WEIGHTS
from assemblyhands_core.models.pretrained import load_hand_keypoints, load_mvexonet
from assemblyhands_core.models.weights_files import read_card
from stages import train_body_keypoints, train_keypoints, train_mvexonet
from stages._contract import Context, Stage
from stages._training import is_held_out

CONF = Path(__file__).parents[2] / "conf" / "stage"
SHORT = {"num_epochs": 3, "steps_per_epoch": 8, "batch_size": 4, "num_loaders": 0, "held_out_share": 0.2}
NET = {"backbone": "mobilenetv3_small_050", "num_levels": 2, "num_channels": 8, "from_imagenet": False}


TAKES = CHUNKS.from_rows(
    [{"sequence_id": "set", "chunk": take, "first_frame": 3 * take, "num_frames": 3} for take in range(4)]
)


def _config(stage: Stage[Any], **changes: Any) -> Any:
    values = yaml.safe_load((CONF / f"{stage.name}.yaml").read_text())
    if "gamma" in values["augmentation"]:  # a dozen hands teach nothing about boxes
        values["augmentation"] |= {"gamma": 1.4, "gamma_spread": 0.1, "center_spread": 0.02}
    return stage.config.model_validate({**values, **SHORT, **changes})


def _run(stage: Stage[Any], config: Any, inputs: dict[str, pa.Table], folder: Path) -> dict[str, pa.Table]:
    folder.mkdir(exist_ok=True)
    return stage.run(config, {"chunks": TAKES, **inputs}, Context(folder, "set", 1, folder / "scratch"))


def _stored(made: dict[str, pa.Table], folder: Path) -> pa.Table:
    """Return the table as the store hands it on: with the file's whole path."""
    (row,) = made["weights"].to_pylist()
    return WEIGHTS.from_rows([{**row, "weights_file": str(folder / row["weights_file"])}])


@pytest.fixture(scope="module")
def keypoints(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, pa.Table], Path]:
    folder = tmp_path_factory.mktemp("keypoints")
    crops, labels = hand_tables(12)
    config = _config(train_keypoints.STAGE, **NET, image_size_px=64, learning_rate=0.01)
    return _run(train_keypoints.STAGE, config, {"crops": crops, "labels": labels}, folder), folder


def test_the_2d_network_learns_and_its_card_tells_from_what(keypoints: Any) -> None:
    made, folder = keypoints
    loss = made["curve"]["loss"].to_pylist()
    assert len(loss) == 3 and loss[2] < 0.9 * loss[0]
    (row,) = made["weights"].to_pylist()
    card = json.loads(row["card"])
    assert (card["samples"], card["held_out"], card["start"]) == (9, 3, "random")
    assert card["data"].startswith("set, simulator version") and card["git commit"]
    assert card["error_px"] == pytest.approx(min(made["curve"]["error"].to_pylist()), abs=1e-3)
    path = folder / row["weights_file"]
    assert digest_file(path) == row["sha256"] and read_card(path)["git commit"] == card["git commit"]
    assert load_hand_keypoints(path).config.image_size_px == 64


def test_mvexonet_starts_from_the_2d_networks_encoder_and_learns(keypoints: Any, tmp_path: Path) -> None:
    crops, labels = hand_tables(12)
    inputs = {"crops": crops, "labels": labels, "start": _stored(*keypoints)}
    shape = {"image_size_px": 64, "num_voxels": 16, "v2v": "slim"}
    made = _run(
        train_mvexonet.STAGE, _config(train_mvexonet.STAGE, **shape, learning_rate=0.003), inputs, tmp_path / "a"
    )
    loss = made["curve"]["loss"].to_pylist()
    assert loss[2] < 0.9 * loss[0]
    start = load_hand_keypoints(Path(inputs["start"]["weights_file"][0].as_py())).encoder.state_dict()
    still = _config(train_mvexonet.STAGE, **shape, learning_rate=1e-12, weight_decay=0.0)
    unmoved = _run(train_mvexonet.STAGE, still, inputs, tmp_path / "b")
    found = load_mvexonet(Path(_stored(unmoved, tmp_path / "b")["weights_file"][0].as_py())).encoder.state_dict()
    learnt = [name for name in start if start[name].is_floating_point() and "running" not in name]
    assert learnt and all(torch.allclose(found[name], start[name], atol=1e-6) for name in learnt)


def _body_rows(num_frames: int) -> pa.Table:
    """Seventeen spots on a diagonal that shifts; the legs are never seen."""
    rows = []
    for frame in range(num_frames):
        points = np.stack([np.linspace(10, 80, 17) + frame, np.linspace(5, 55, 17)], axis=-1)
        image = np.full((64, 96, 3), 30, np.uint8)
        for index, (x, y) in enumerate(points):
            cv2.circle(image, (round(x), round(y)), 2, (250 - 10 * index, 80 + 10 * index, 90), -1)
        is_valid = np.arange(17) < 13
        pixels = np.where(is_valid[:, None], points, np.nan).ravel()
        row = {"sequence_id": "set", "frame": frame, "camera_id": "c", "image": encode_jpeg(image, 95)}
        rows.append({**row, "body_px": pixels, "valid": is_valid})
    return BODY_LABELS.from_rows(rows)


def test_the_body_network_learns(tmp_path: Path) -> None:
    config = _config(train_body_keypoints.STAGE, **NET, image_width_px=96, learning_rate=0.01)
    made = _run(train_body_keypoints.STAGE, config, {"labels": _body_rows(12)}, tmp_path)
    loss = made["curve"]["loss"].to_pylist()
    assert loss[2] < 0.9 * loss[0]
    network = load_hand_keypoints(Path(_stored(made, tmp_path)["weights_file"][0].as_py()))
    assert (network.config.num_joints, network.config.image_size_px) == (17, 96)


def test_a_training_goes_on_from_weights_of_the_same_shape(keypoints: Any, tmp_path: Path) -> None:
    path = Path(_stored(*keypoints)["weights_file"][0].as_py())
    crops, labels = hand_tables(12)
    going_on = {"start_from": str(path), "learning_rate": 1e-12, "weight_decay": 0.0}
    config = _config(train_keypoints.STAGE, **NET, image_size_px=64, **going_on)
    made = _run(train_keypoints.STAGE, config, {"crops": crops, "labels": labels}, tmp_path / "a")
    card = json.loads(made["weights"]["card"][0].as_py())
    assert card["start"] == str(path)
    assert made["curve"]["loss"][0].as_py() < 0.95 * keypoints[0]["curve"]["loss"][0].as_py()
    before, after = (
        dict(load_hand_keypoints(p).named_parameters()) for p in (path, tmp_path / "a" / "weights.safetensors")
    )
    assert all(torch.allclose(after[name], before[name], atol=1e-6) for name in before)
    other = _config(train_keypoints.STAGE, **NET, image_size_px=32, start_from=str(path))
    with pytest.raises(ValueError, match="of a network with image_size_px=64: train one of that shape"):
        _run(train_keypoints.STAGE, other, {"crops": crops, "labels": labels}, tmp_path / "b")


def test_what_a_training_starts_from_is_part_of_its_key(keypoints: Any) -> None:
    path = Path(_stored(*keypoints)["weights_file"][0].as_py())
    externals = train_keypoints.STAGE.externals
    assert externals(_config(train_keypoints.STAGE, start_from=str(path)), "set") == {"start": digest_file(path)}
    assert externals(_config(train_keypoints.STAGE, **NET), "set") == {}
    with pytest.raises(ValueError, match=r"There are no weights at .*absent\.safetensors"):
        externals(_config(train_keypoints.STAGE, start_from="absent.safetensors"), "set")


ROWS = pa.table({"sequence_id": ["set"] * 12 + ["tuesday"] * 2, "frame": [*range(12), 0, 5]})


@pytest.mark.parametrize(("share", "border"), [(0.02, 9), (0.25, 9), (0.26, 9), (0.5, 6), (0.75, 3), (0.99, 3)])
def test_whole_takes_are_held_out_and_never_all(share: float, border: int) -> None:
    assert is_held_out(ROWS.slice(0, 12), TAKES, share).to_pylist() == [frame >= border for frame in range(12)]


def test_of_several_sequences_the_last_takes_are_held_out() -> None:
    later = {"sequence_id": "tuesday", "chunk": 0, "first_frame": 0, "num_frames": 9}
    takes = pa.concat_tables([CHUNKS.from_rows([later]), TAKES])
    assert is_held_out(ROWS, takes, 0.2).to_pylist() == [False] * 12 + [True] * 2
    assert is_held_out(ROWS, takes, 0.4).to_pylist() == [False] * 9 + [True] * 5


def test_one_take_alone_cannot_be_split() -> None:
    with pytest.raises(ValueError, match="train on two takes or more"):
        is_held_out(ROWS, TAKES.slice(0, 1), 0.1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_voxels": 36}, "num_voxels=36 must be a multiple of 8 for v2v=slim"),
        ({"num_voxels": 48, "v2v": "reference"}, "must be a multiple of 32 for v2v=reference"),
        ({"augmentation": {"min_views": 4, "max_views": 3}}, "min_views=4 must not be above max_views=3"),
    ],
)
def test_what_could_only_fail_later_is_refused_at_once(changes: dict[str, Any], message: str) -> None:
    values = yaml.safe_load((CONF / "train_mvexonet.yaml").read_text())
    values["augmentation"] |= changes.pop("augmentation", {})
    with pytest.raises(ValidationError, match=message):
        train_mvexonet.TrainMvexonetConfig.model_validate({**values, **changes})
