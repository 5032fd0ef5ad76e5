"""Weights that are there already come with their card; without them it says how to get some."""

import json
from pathlib import Path

import pytest
import torch

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.models.pretrained import load_svegonet, save_weights
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
from stages import use_msg3d, use_svegonet
from stages._contract import Context, Stage
from stages._shipped_weights import UseWeightsConfig


def test_the_weights_are_a_result_with_their_card(tmp_path: Path) -> None:
    path, blobs = tmp_path / "mine.safetensors", tmp_path / "blobs"
    blobs.mkdir()
    torch.manual_seed(0)
    save_weights(path, SVEgoNet(SVEgoNetConfig("mobilenetv3_small_050", 2, 8, 64, 8)), {"data": "nothing"})
    config = UseWeightsConfig(weights=str(path))
    assert use_svegonet.STAGE.externals(config, "all") == {"weights": digest_file(path)}
    (row,) = use_svegonet.STAGE.run(config, {}, Context(blobs, "all"))["weights"].to_pylist()
    assert row["sha256"] == digest_file(path) and json.loads(row["card"])["data"] == "nothing"
    assert row["network"] == "SVEgoNet"
    assert load_svegonet(blobs / row["weights_file"]).config.num_depths == 8


@pytest.mark.parametrize(("stage", "target"), [(use_svegonet.STAGE, "train_ego"), (use_msg3d.STAGE, "verb_weights")])
def test_without_weights_it_says_what_to_do(stage: Stage[UseWeightsConfig], target: str) -> None:
    message = (
        rf"no weights at .*nothing\.safetensors: train them \(target={target}\), or give {stage.name}.weights=PATH"
    )
    with pytest.raises(ValueError, match=message):
        stage.externals(UseWeightsConfig(weights="weights/nothing.safetensors"), "all")
