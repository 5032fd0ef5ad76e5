"""MS-G3D against its textbook form and against the numbers of the public implementation."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from reference_weights import reference_weights
from textbook_msg3d import (
    GraphLayer,
    TextbookMSG3D,
    graph_weights,
    our_weights,
    temporal_weights,
    unfold_windows,
)
from torch import Tensor, nn

from assemblyhands_core.hands.graphs import EDGES, adjacency
from assemblyhands_core.models.msg3d import BASE, MSG3D, SMALL, MSG3DConfig
from assemblyhands_core.models.msg3d_blocks import GraphConvolution, TemporalConvolutions

LANDMARKS = adjacency(EDGES["landmarks"])
TINY = MSG3DConfig(num_classes=4, num_gcn_scales=4, num_g3d_scales=3, c1=6, c2=12, c3=18)
PUBLISHED = replace(BASE, graph="landmarks")
GOLDEN = {"full": PUBLISHED, "small": replace(PUBLISHED, num_gcn_scales=3, num_g3d_scales=2)}


def num_parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def randomised(network: nn.Module) -> nn.Module:
    """With statistics, and with adjacencies that are learnt, in them."""
    generator = torch.Generator().manual_seed(0)
    for name, value in network.state_dict().items():
        if name.endswith(("running_mean", "A_res", "bias")):
            value.copy_(0.1 * torch.randn(value.shape, generator=generator))
        elif name.endswith("running_var"):
            value.copy_(torch.rand(value.shape, generator=generator) + 0.5)
    return network


def fill(network: nn.Module, weights: dict[str, Tensor]) -> None:
    missing, unexpected = network.load_state_dict(weights, strict=False)
    assert not unexpected and all(name.endswith("num_batches_tracked") for name in missing)


def channels_last(x: Tensor) -> Tensor:
    return x.permute(0, 2, 3, 1).contiguous()


def both_networks(config: MSG3DConfig) -> tuple[nn.Module, MSG3D]:
    textbook, ours = randomised(TextbookMSG3D(config)).double(), MSG3D(config).double()
    fill(ours, our_weights(textbook.state_dict()))
    return textbook, ours


def test_sizes() -> None:
    assert num_parameters(MSG3D(BASE)) == num_parameters(MSG3D(PUBLISHED)) == 3_053_973
    assert num_parameters(MSG3D(replace(BASE, num_classes=24))) == 3_060_903
    assert num_parameters(MSG3D(GOLDEN["small"])) == 2_026_191
    assert 150_000 < num_parameters(MSG3D(SMALL)) < 350_000


@pytest.mark.parametrize("frames", [1, 9, 12])
def test_logits_are_those_of_the_textbook(frames: int) -> None:
    textbook, ours = both_networks(TINY)
    poses = torch.randn(2, 3, frames, 21, 2, dtype=torch.float64)
    with torch.no_grad():
        expected = textbook.eval()(poses)
        torch.testing.assert_close(ours.eval()(poses), expected, rtol=1e-9, atol=1e-9)
    assert expected.shape == (2, 4) and expected.std() > 1e-3


def test_training_is_that_of_the_textbook() -> None:
    """Outputs, gradients and running statistics of one step; biases before a batch norm have no gradient."""
    textbook, ours = both_networks(TINY)
    poses, labels = torch.randn(3, 3, 10, 21, 2, dtype=torch.float64), torch.tensor([0, 3, 1])
    for network in (textbook, ours):
        nn.functional.cross_entropy(network.train()(poses), labels).backward()
    gradients = {name: parameter.grad for name, parameter in textbook.named_parameters()}
    expected = our_weights({**textbook.state_dict(), **gradients})
    for name, parameter in ours.named_parameters():
        torch.testing.assert_close(parameter.grad, expected[name], rtol=1e-7, atol=1e-10, msg=name)
    for name, value in ours.named_buffers():
        if "running" in name:
            torch.testing.assert_close(value, expected[name], rtol=1e-9, atol=1e-12, msg=name)


@pytest.mark.parametrize(("inputs", "outputs"), [(3, 5), (5, 5), (5, 3)])
def test_both_orders_of_a_graph_convolution_are_the_textbook_s(inputs: int, outputs: int) -> None:
    textbook = randomised(GraphLayer(inputs, outputs, "skeleton", 4, window=3)).eval()
    ours = GraphConvolution(inputs, outputs, adjacency(EDGES["skeleton"]), 4, window=3, stride=2).eval()
    fill(ours, graph_weights(textbook.state_dict()))
    x = torch.randn(2, inputs, 7, 21)
    with torch.no_grad():
        found, expected = ours(channels_last(x)), textbook(unfold_windows(x, 3, stride=2))
    by_joint = channels_last(expected).unflatten(2, (3, 21)).transpose(2, 3)
    torch.testing.assert_close(found, by_joint, rtol=1e-4, atol=1e-5)


def test_scales_beyond_the_diameter_are_the_identity() -> None:
    beyond = GraphConvolution(3, 4, LANDMARKS, num_scales=11).adjacency[9:]
    assert torch.equal(beyond, torch.eye(21).expand(2, 21, 21))


def test_branches_and_their_channels_go_together() -> None:
    with pytest.raises(ValueError, match="40 channels cannot be shared by 6 branches"):
        TemporalConvolutions(6, 40)


def test_features_of_frames_count_by_their_mean() -> None:
    network = MSG3D(replace(TINY, num_frame_features=2)).eval()
    poses, features = torch.randn(1, 3, 4, 21, 2), torch.tensor([[[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 0.0]]])
    with torch.no_grad():
        with_none, with_features = network(poses, torch.zeros_like(features)), network(poses, features)
    expected = network.classifier.weight[:, -2:] @ torch.tensor([0.75, 0.25])
    torch.testing.assert_close((with_features - with_none)[0], expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("known", "given"), [(2, None), (0, 2), (3, 2)])
def test_features_that_the_network_was_not_made_for_are_refused(known: int, given: int | None) -> None:
    features = None if given is None else torch.zeros(1, 8, given)
    with pytest.raises(
        ValueError, match=f"There are {given or 0} features of each frame and the network takes {known}"
    ):
        MSG3D(replace(TINY, num_frame_features=known))(torch.zeros(1, 3, 8, 21, 2), features)


def test_every_parameter_learns_and_mixed_precision_is_near() -> None:
    network = MSG3D(replace(TINY, num_frame_features=2))
    inputs = torch.randn(4, 3, 16, 21, 2), torch.rand(4, 16, 2)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        network(*inputs).float().square().sum().backward()
    assert all(parameter.grad is not None and parameter.grad.isfinite().all() for parameter in network.parameters())
    with torch.no_grad():
        exact = network.eval()(*inputs)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            torch.testing.assert_close(network(*inputs).float(), exact, rtol=0.05, atol=0.05)


def test_dropout_is_of_training_alone() -> None:
    torch.manual_seed(0)
    network, poses = MSG3D(replace(TINY, dropout=0.5)), torch.randn(4, 3, 6, 21, 2)
    with torch.no_grad():
        assert not torch.equal(network(poses), network(poses))
        network.eval()
        assert torch.equal(network(poses), network(poses))


LAYERS: dict[str, tuple[Callable[[], nn.Module], Callable[[dict[str, Tensor]], dict[str, Tensor]]]] = {
    "ms_gcn": (lambda: GraphConvolution(3, 8, LANDMARKS, num_scales=4), graph_weights),
    "ms_tcn_s1": (lambda: TemporalConvolutions(12, 12), temporal_weights),
    "ms_tcn_s2": (lambda: TemporalConvolutions(12, 24, stride=2), temporal_weights),
}


def block_of(golden_dir: Path, name: str) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """Weights, input and output of one block of the reference program."""
    with np.load(golden_dir / "msg3d_blocks.npz") as file:
        arrays = {
            key.removeprefix(f"{name}/"): torch.from_numpy(file[key]) for key in file if key.startswith(f"{name}/")
        }
    return {key.removeprefix("w/"): arrays[key] for key in arrays if key.startswith("w/")}, arrays["x"], arrays["y"]


@pytest.mark.parametrize("name", LAYERS)
def test_layers_of_the_reference_program(golden_dir: Path, name: str) -> None:
    weights, x, y = block_of(golden_dir, name)
    build, renamed = LAYERS[name]
    layer = build().eval()
    fill(layer, renamed(weights))
    with torch.no_grad():
        found = layer(channels_last(x))
    torch.testing.assert_close(found.view(channels_last(y).shape), channels_last(y), rtol=0, atol=1e-4)


def test_windows_of_the_reference_program(golden_dir: Path) -> None:
    """Its windows hold arbitrary numbers; as every third window of a sequence they do not overlap."""
    weights, x, y = block_of(golden_dir, "st_gcn_w3")
    layer = GraphConvolution(3, 6, LANDMARKS, num_scales=3, window=3, stride=3).eval()
    fill(layer, graph_weights(weights))
    frames = channels_last(x).view(2, 9 * 3, 21, 3)
    with torch.no_grad():
        found = layer(torch.cat((torch.zeros(2, 2, 21, 3), frames), dim=1))[:, 1:]
    expected = channels_last(y).unflatten(2, (3, 21)).transpose(2, 3)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("window", "stride", "dilation"), [(3, 1, 1), (5, 1, 1), (3, 2, 1), (5, 2, 1), (3, 1, 2)])
def test_the_textbook_unfolds_as_the_reference_program(
    golden_dir: Path, window: int, stride: int, dilation: int
) -> None:
    _, x, y = block_of(golden_dir, f"unfold_w{window}_s{stride}_d{dilation}")
    assert torch.equal(unfold_windows(x, window, stride, dilation), y)


def reference_activations(network: MSG3D) -> dict[str, list[Tensor]]:
    """Register what the network computes on its way, under the reference's names; two windows' are to be added."""
    found: dict[str, list[Tensor]] = {}

    def keep(name: str, module: nn.Module) -> None:
        module.register_forward_hook(lambda module, inputs, output: found.setdefault(name, []).append(output.clone()))

    keep("data_bn", network.input_norm)
    for place, block in enumerate(network.blocks, start=1):
        keep(f"sgcn{place}", block.inner)
        keep(f"tcn{place}", block.last)
        for window in block.windows:
            keep(f"gcn3d{place}", window)
    return found


def sampled(activation: Tensor) -> Tensor:
    """The part of an activation that the reference's numbers hold."""
    if activation.ndim == 3:
        return activation[:, ::7, ::4]
    images = activation.permute(0, 3, 1, 2)
    return images[:2, :: max(1, images.shape[1] // 8), :: max(1, images.shape[2] // 5), ::5]


@pytest.mark.parametrize("size", GOLDEN)
def test_the_whole_network_of_the_reference_program(golden_dir: Path, size: str) -> None:
    with np.load(golden_dir / "msg3d.npz") as file:
        golden = {key.removeprefix(f"{size}/"): file[key] for key in file if key.startswith(f"{size}/")}
    network = MSG3D(GOLDEN[size]).eval()
    assert num_parameters(network) == golden["n_params"]
    fill(network, our_weights(reference_weights(golden)))
    activations = reference_activations(network)
    with torch.no_grad():
        logits = network(torch.from_numpy(golden["x"].astype(np.float32)))
    np.testing.assert_allclose(logits, golden["y_f64"], rtol=1e-4, atol=1e-4 * np.abs(golden["y_f64"]).max())
    for name in (key.removeprefix("inter/") for key in golden if key.startswith("inter/")):
        expected = golden[f"inter/{name}"]
        found = sampled(torch.stack(activations[name]).sum(dim=0))
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max(), err_msg=name)
