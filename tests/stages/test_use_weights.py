"""Weights that are there already come with their card; without them it says how to get some."""

import json
from pathlib import Path

import pytest
import torch

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.models.pretrained import load_svegonet, save_weights
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
from stages._contract import Context
from stages.use_weights import MSG3D, SVEGONET, UseWeightsConfig


def test_the_weights_are_a_result_with_their_card(tmp_path: Path) -> None:
    path, blobs = tmp_path / "mine.safetensors", tmp_path / "blobs"
    blobs.mkdir()
    torch.manual_seed(0)
    save_weights(path, SVEgoNet(SVEgoNetConfig("mobilenetv3_small_050", 2, 8, 64, 8)), {"data": "nothing"})
    config = UseWeightsConfig(svegonet=str(path), msg3d="weights/nothing.safetensors")
    assert SVEGONET.externals(config, "all") == {"SVEgoNet": digest_file(path)}
    (row,) = SVEGONET.run(config, {}, Context(blobs, "all"))["weights"].to_pylist()
    assert row["sha256"] == digest_file(path) and json.loads(row["card"])["data"] == "nothing"
    assert load_svegonet(blobs / row["weights_file"]).config.num_depths == 8


def test_without_weights_it_says_what_to_do() -> None:
    with pytest.raises(ValueError, match=r"no weights at .*nothing\.safetensors: train them \(target=train_ego\)"):
        SVEGONET.externals(_nothing(), "all")
    with pytest.raises(ValueError, match=r"no weights at .*none\.safetensors: train them \(target=train_verbs\)"):
        MSG3D.externals(_nothing(), "all")


def _nothing() -> UseWeightsConfig:
    return UseWeightsConfig(svegonet="weights/nothing.safetensors", msg3d="weights/none.safetensors")
