"""V2V: capacity and values of the reference program, whose names are mapped here; and the slim one."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from reference_weights import reference_weights
from torch import nn

from assemblyhands_core.models.v2v import (
    ConvolutionBlock,
    EncoderDecoder,
    ReferenceV2V,
    ResidualBlock,
    SlimV2V,
    UpsamplingBlock,
    build_v2v,
)

NUM_PARAMETERS = 11_944_485
RENAMED = (
    (r"^front_layers\.", "front."),
    (r"^back_layers\.", "back."),
    (r"^output_layer\.", "output."),
    (r"\.mid_res\.", ".middle.0."),
    (r"\.(skip|encoder|decoder)_res(\d)\.", lambda found: f".{found[1]}s.{int(found[2]) - 1}."),
    (r"\.decoder_upsample(\d)\.", lambda found: f".upsamplings.{int(found[1]) - 1}."),
    (r"(^|\.)res_branch\.", r"\1branch."),
    (r"(^|\.)skip_con\.", r"\1skip."),
    (r"(^|\.)block\.", r"\1"),
)


def our_name(name: str) -> str:
    for pattern, replacement in RENAMED:
        name = re.sub(pattern, replacement, name)
    return name


def num_parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_reference_has_the_published_capacity() -> None:
    assert num_parameters(ReferenceV2V(32, 21)) == NUM_PARAMETERS
    assert num_parameters(ReferenceV2V(6, 5)) == 11_801_269


def test_the_slim_one_is_a_tenth_and_keeps_the_size() -> None:
    network = build_v2v("slim", 32, 21)
    assert 0.05 < num_parameters(network) / NUM_PARAMETERS < 0.15
    assert network(torch.zeros(2, 32, 16, 16, 16)).shape == (2, 21, 16, 16, 16)
    widths = {module.out_channels for module in network.modules() if isinstance(module, nn.Conv3d)}
    assert all(width % 8 == 0 for width in widths)


@pytest.mark.parametrize(("network", "side"), [(SlimV2V(2, 3), 12), (ReferenceV2V(2, 3), 48)])
def test_sides_that_cannot_be_halved_are_refused(network: nn.Module, side: int) -> None:
    with pytest.raises(ValueError, match=f"multiples of {network.divisor}"):
        network(torch.zeros(1, 2, side, side, side))


def test_every_parameter_of_both_takes_part() -> None:
    for network, side in ((SlimV2V(3, 5), 8), (EncoderDecoder((4, 8, 8), num_blocks=1), 8)):
        inputs = next(module for module in network.modules() if isinstance(module, nn.Conv3d)).in_channels
        network(torch.randn(2, inputs, side, side, side)).square().sum().backward()
        assert all(parameter.grad is not None for parameter in network.parameters())


BLOCKS = {
    "res_same": lambda: ResidualBlock(6, 6),
    "res_change": lambda: ResidualBlock(4, 6),
    "basic7": lambda: ConvolutionBlock(3, 4, kernel=7),
    "basic1": lambda: ConvolutionBlock(5, 4, kernel=1),
    "up": lambda: UpsamplingBlock(6, 4),
    "pool": lambda: nn.MaxPool3d(2),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_blocks_of_the_reference_program(golden_dir: Path, name: str) -> None:
    with np.load(golden_dir / "v2v_blocks.npz") as file:
        weights = {key.split("/w/")[1]: torch.from_numpy(file[key]) for key in file if key.startswith(f"{name}/w/")}
        x, y = torch.from_numpy(file[f"{name}/x"]), file[f"{name}/y"]
    block = BLOCKS[name]().eval()
    missing, unexpected = block.load_state_dict({our_name(key): value for key, value in weights.items()}, strict=False)
    assert not unexpected and all(key.endswith("num_batches_tracked") for key in missing)
    with torch.no_grad():
        np.testing.assert_allclose(block(x), y, rtol=0, atol=1e-4)


def test_the_whole_network_of_the_reference_program(golden_dir: Path) -> None:
    with np.load(golden_dir / "v2v.npz") as file:
        golden = {key: file[key] for key in ("names", "shapes", "ndim", "weight_seed", "first_value", "x", "y")}
    network = ReferenceV2V(6, 5).eval()
    weights = {our_name(name): tensor for name, tensor in reference_weights(golden).items()}
    network.load_state_dict(weights)
    with torch.no_grad():
        heatmaps = network(torch.from_numpy(golden["x"].astype(np.float32)))
    np.testing.assert_allclose(heatmaps, golden["y"], rtol=0, atol=5e-3)
