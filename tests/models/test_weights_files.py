"""Weights from elsewhere: nothing in them is believed, and no room is made for what they only claim."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.pose_sequences import REFERENCE
from assemblyhands_core.models.encoder import ImageEncoder
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
from assemblyhands_core.models.pretrained import load_hand_keypoints, load_msg3d, save_weights, start_from_weights
from assemblyhands_core.models.verb_classification import VerbClassifier
from assemblyhands_core.models.weights_files import read_card

HANDS_2D = HandKeypointConfig("mobilenetv3_small_050", 2, 8, image_size_px=64)
VERBS_3D = MSG3DConfig(num_classes=2, num_gcn_scales=2, num_g3d_scales=2, c1=6, c2=6, c3=12)


@pytest.fixture(scope="module")
def hands_2d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hands") / "hands.safetensors"
    save_weights(path, HandKeypointNet(HANDS_2D), {})
    return path


def _with(path: Path, target: Path, card: Mapping[str, str | None], **tensors: torch.Tensor) -> Path:
    """Write a weights file again, with other words in its header and other tensors."""
    said = {**read_card(path), **card}
    target.parent.mkdir(exist_ok=True)
    save_file(
        {**load_file(path), **tensors}, target, {name: value for name, value in said.items() if value is not None}
    )
    return target


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"num_channels": 2**40}, "its num_channels is 1099511627776"), ({"num_channels": 8.0}, "its num_channels is"),
        ({"num_channels": True}, "its num_channels is True"), ({"num_channels": -1}, "its num_channels is -1"),
        ({"num_levels": 9}, "its num_levels is 9"), ({"num_levels": 0}, "there is no network as it describes"),
        ({"backbone": ["x"]}, "its backbone is a list"), ({"backbone": "hf-hub:a/b"}, "is none that timm has"),
        ({"backbone": "local-dir:/etc"}, "is none that timm has"), ({"confidence_radius_px": 1e999}, "is inf"),
        ({"evil": 1}, "'evil' is missing or unknown"), ({"num_channels": 16}, "weights are others than its network's"),
        ({"backbone": "mobilenetv3_large_100"}, "weights are others than its network's"),
    ],
)  # fmt: skip
def test_a_config_that_no_network_of_ours_has_is_refused(
    hands_2d: Path, tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    config = json.dumps({**asdict(HANDS_2D), **change})
    path = _with(hands_2d, tmp_path / "evil.safetensors", {"config": config})
    with pytest.raises(FormatError, match=reason) as refused:
        load_hand_keypoints(path)
    assert str(refused.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("config", "reason"),
    [(None, "lacks 'config'"), ("", "is no JSON"), ("[]", "expected a JSON object"), ('{"a":' * 10**5, "without end")],
)
def test_a_card_without_a_config_is_refused(hands_2d: Path, tmp_path: Path, config: str | None, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        load_hand_keypoints(_with(hands_2d, tmp_path / "evil.safetensors", {"config": config}))


def test_no_network_is_built_for_other_weights(hands_2d: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    devices: list[str] = []
    monkeypatch.setattr(
        HandKeypointNet, "__init__", _noting(HandKeypointNet.__init__, devices, torch.get_default_device)
    )
    load_hand_keypoints(hands_2d)
    assert devices == ["meta", "cpu"]
    with pytest.raises(
        FormatError, match=r"1 weights are others than its network's, further is \(3,\) instead of none"
    ):
        load_hand_keypoints(_with(hands_2d, tmp_path / "more.safetensors", {}, further=torch.zeros(3)))
    assert devices == ["meta", "cpu", "meta"]


def _noting(init: Any, devices: list[str], device: Any) -> Any:
    def noting(*arguments: Any) -> None:
        devices.append(device().type)
        init(*arguments)

    return noting


def test_bytes_that_are_no_weights_are_refused(hands_2d: Path, tmp_path: Path) -> None:
    path, data = tmp_path / "cut.safetensors", hands_2d.read_bytes()
    for content in (b"", data[:100], data[:-1], b"\xff" * 8 + data[8:], b"\x80\x04K\x01."):
        path.write_bytes(content)
        for load in (load_hand_keypoints, read_card):
            with pytest.raises(FormatError, match="cannot be read as weights"):
                load(path)
    with pytest.raises(FormatError, match=r"none.safetensors: cannot be read as weights"):
        read_card(tmp_path / "none.safetensors")


def test_going_on_with_damaged_weights_is_refused(hands_2d: Path, tmp_path: Path) -> None:
    network = HandKeypointNet(HANDS_2D)
    start_from_weights(network, hands_2d)
    name = next(iter(network.state_dict()))
    with pytest.raises(FormatError, match="1 weights are others"):
        start_from_weights(network, _with(hands_2d, tmp_path / "e.safetensors", {}, **{name: torch.zeros(1, 2, 3)}))


def test_only_backbones_that_timm_has_itself_are_built() -> None:
    with pytest.raises(ValueError, match="Backbone hf-hub:someone/something is none that timm has"):
        ImageEncoder("hf-hub:someone/something", 8, 2)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""), ({"verbs": ["one"]}, "names 1 verbs and 0 nouns"), ({"verbs": [1, 2]}, "1 is no name"),
        ({"verbs": "ab"}, "expected a JSON list"), ({"sequence": 3}, "expected a JSON object"),
        ({"sequence": {}}, "missing or unknown"), ({"nouns": None}, "expected a JSON list"),
        ({"sequence": {**asdict(REFERENCE), "num_frames": 10**9}}, "its num_frames is 1000000000"),
        ({"sequence": {**asdict(REFERENCE), "hands": ["left", "left"]}}, "name right and left, each once"),
        ({"sequence": {**asdict(REFERENCE), "hands": [["left"], "right"]}}, "a list of 1 is no name"),
        ({"sequence": {**asdict(REFERENCE), "length": "endless"}}, "its length is 'endless'"),
    ],
)  # fmt: skip
def test_what_a_verb_classifier_says_of_itself_is_checked(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    said = {"verbs": ["a", "b"], "nouns": [], "sequence": asdict(REFERENCE)} | change
    path = tmp_path / "verbs.safetensors"
    save_weights(path, MSG3D(VERBS_3D), {"classifier": json.dumps(said)})
    assert load_msg3d(path).config == VERBS_3D
    if not reason:
        assert VerbClassifier.load(path).sequence == REFERENCE
        return
    with pytest.raises(FormatError, match=reason):
        VerbClassifier.load(path)
