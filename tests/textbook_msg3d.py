"""MS-G3D as its paper states it, one layer a formula: what ours is held against, in tests and in the benchmark.

Its parameters have the names under which weights of the public implementation are stored; `our_weights` maps them.
Source: Liu et al., CVPR 2020, Sec. 3 and Fig. 3–4.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from assemblyhands_core.hands.graphs import EDGES, adjacency, scale_matrices, window_adjacency
from assemblyhands_core.models.msg3d import MSG3DConfig

DILATIONS = (1, 2, 3, 4)
WINDOWS = (3, 5)


def unfold_windows(x: Tensor, window: int, stride: int = 1, dilation: int = 1) -> Tensor:
    """Return all frames of each window (N, C, T', window · V) of (N, C, T, V), with zeros outside of the sequence."""
    reach = dilation * (window - 1)
    padded = F.pad(x, (0, 0, reach // 2, reach // 2))
    frames = [padded[:, :, k * dilation : padded.shape[2] - reach + k * dilation : stride] for k in range(window)]
    return torch.cat(frames, dim=3)


class Perceptron(nn.Module):
    def __init__(self, num_inputs: int, num_outputs: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Conv2d(num_inputs, num_outputs, 1), nn.BatchNorm2d(num_outputs), nn.ReLU())

    def forward(self, x: Tensor) -> Tensor:
        return self.layers(x)


class GraphLayer(nn.Module):
    """Sum over scales of (A + A_res) X W, batch norm, ReLU; over single frames or over windows."""

    def __init__(self, num_inputs: int, num_outputs: int, graph: str, num_scales: int, window: int = 1) -> None:
        super().__init__()
        is_joined = adjacency(EDGES[graph])
        matrices = scale_matrices(window_adjacency(is_joined, window) if window > 1 else is_joined, num_scales)
        self.num_scales = num_scales
        self.register_buffer("A", torch.tensor(matrices).flatten(0, 1).float(), persistent=False)
        self.A_res = nn.Parameter(torch.empty_like(self.A).uniform_(-1e-6, 1e-6))
        self.mlp = Perceptron(num_inputs * num_scales, num_outputs)

    def forward(self, x: Tensor) -> Tensor:
        batch, channels, frames, nodes = x.shape
        mixed = torch.einsum("vu,nctu->nctv", self.A + self.A_res, x)
        mixed = mixed.view(batch, channels, frames, self.num_scales, nodes).permute(0, 3, 1, 2, 4)
        return self.mlp(mixed.reshape(batch, self.num_scales * channels, frames, nodes))


class Unfold(nn.Module):
    def __init__(self, window: int, stride: int) -> None:
        super().__init__()
        self.window, self.stride = window, stride

    def forward(self, x: Tensor) -> Tensor:
        return unfold_windows(x, self.window, self.stride)


class WindowLayer(nn.Module):
    """A graph layer over windows, which a convolution collapses to one frame each."""

    def __init__(
        self, num_inputs: int, num_outputs: int, graph: str, num_scales: int, window: int, stride: int
    ) -> None:
        super().__init__()
        width = num_outputs if num_inputs == 3 else num_inputs
        self.window = window
        self.gcn3d = nn.Sequential(Unfold(window, stride), GraphLayer(num_inputs, width, graph, num_scales, window))
        self.out_conv = nn.Conv3d(width, num_outputs, (1, window, 1))
        self.out_bn = nn.BatchNorm2d(num_outputs)

    def forward(self, x: Tensor) -> Tensor:
        x = self.gcn3d(x)
        return self.out_bn(self.out_conv(x.unflatten(3, (self.window, -1))).squeeze(3))


class WindowPathway(nn.Module):
    def __init__(self, num_inputs: int, num_outputs: int, graph: str, num_scales: int, stride: int) -> None:
        super().__init__()
        self.gcn3d = nn.ModuleList(
            WindowLayer(num_inputs, num_outputs, graph, num_scales, window, stride) for window in WINDOWS
        )

    def forward(self, x: Tensor) -> Tensor:
        return sum(layer(x) for layer in self.gcn3d)


class TemporalConvolution(nn.Module):
    def __init__(self, num_inputs: int, num_outputs: int, kernel: int, stride: int, dilation: int = 1) -> None:
        super().__init__()
        padding = dilation * (kernel - 1) // 2
        self.conv = nn.Conv2d(num_inputs, num_outputs, (kernel, 1), (stride, 1), (padding, 0), (dilation, 1))
        self.bn = nn.BatchNorm2d(num_outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.bn(self.conv(x))


class TemporalLayer(nn.Module):
    """Six branches side by side: four dilations, maximum, one frame; added to what came in."""

    def __init__(self, num_inputs: int, num_outputs: int, stride: int = 1, has_relu: bool = True) -> None:
        super().__init__()
        width = num_outputs // 6
        branches = [
            [*_entry(num_inputs, width), TemporalConvolution(width, width, 3, stride, dilation)]
            for dilation in DILATIONS
        ]
        branches.append([*_entry(num_inputs, width), nn.MaxPool2d((3, 1), (stride, 1), (1, 0)), nn.BatchNorm2d(width)])
        branches.append([nn.Conv2d(num_inputs, width, 1, (stride, 1)), nn.BatchNorm2d(width)])
        self.branches = nn.ModuleList(nn.Sequential(*branch) for branch in branches)
        self.residual: nn.Module = nn.Identity()
        if stride != 1 or num_inputs != num_outputs:
            self.residual = TemporalConvolution(num_inputs, num_outputs, 1, stride)
        self.has_relu = has_relu

    def forward(self, x: Tensor) -> Tensor:
        out = torch.cat([branch(x) for branch in self.branches], dim=1) + self.residual(x)
        return out.relu() if self.has_relu else out


def _entry(num_inputs: int, width: int) -> tuple[nn.Module, ...]:
    return nn.Conv2d(num_inputs, width, 1), nn.BatchNorm2d(width), nn.ReLU()


class TextbookMSG3D(nn.Module):
    """Three blocks of two pathways each, mean over joints, frames and hands, one linear layer."""

    def __init__(self, config: MSG3DConfig) -> None:
        super().__init__()
        self.data_bn = nn.BatchNorm1d(config.num_persons * 21 * 3)
        widths, graph = (3, config.c1, config.c2, config.c3), config.graph
        for place in (1, 2, 3):
            before, after, stride = widths[place - 1], widths[place], 1 if place == 1 else 2
            inner = after if place == 1 else before
            pathway = WindowPathway(before, after, graph, config.num_g3d_scales, stride)
            factored = nn.Sequential(
                GraphLayer(before, inner, graph, config.num_gcn_scales),
                TemporalLayer(inner, after, stride),
                TemporalLayer(after, after, has_relu=False),
            )
            self.add_module(f"gcn3d{place}", pathway)
            self.add_module(f"sgcn{place}", factored)
            self.add_module(f"tcn{place}", TemporalLayer(after, after))
        self.fc = nn.Linear(config.c3, config.num_classes)

    def forward(self, x: Tensor) -> Tensor:
        samples, channels, frames, joints, hands = x.shape
        x = self.data_bn(x.permute(0, 4, 3, 1, 2).reshape(samples, hands * joints * channels, frames))
        x = x.view(samples * hands, joints, channels, frames).permute(0, 2, 3, 1).contiguous()
        for place in (1, 2, 3):
            both = getattr(self, f"sgcn{place}")(x) + getattr(self, f"gcn3d{place}")(x)
            x = getattr(self, f"tcn{place}")(both.relu())
        return self.fc(x.mean(dim=(2, 3)).view(samples, hands, -1).mean(dim=1))


def our_weights(theirs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights of our network that compute what these do; running counts of batches are left out."""
    ours = _renamed(theirs, "data_bn.", "input_norm.") | _renamed(theirs, "fc.", "classifier.")
    for k in range(3):
        place, block = k + 1, f"blocks.{k}."
        ours |= graph_weights(_below(theirs, f"sgcn{place}.0."), block + "graph.")
        for prefix, layer in (
            (f"sgcn{place}.1.", "inner.0."),
            (f"sgcn{place}.2.", "inner.1."),
            (f"tcn{place}.", "last."),
        ):
            ours |= temporal_weights(_below(theirs, prefix), block + layer)
        for window in range(len(WINDOWS)):
            layer = _below(theirs, f"gcn3d{place}.gcn3d.{window}.")
            prefix = f"{block}windows.{window}."
            ours |= graph_weights(_below(layer, "gcn3d.1."), prefix + "graph.")
            ours |= _renamed(layer, "out_bn.", prefix + "collapse.norm.")
            ours[prefix + "collapse.weight"] = layer["out_conv.weight"][:, :, 0, :, 0].transpose(1, 2).flatten(1)
            ours[prefix + "collapse.bias"] = layer["out_conv.bias"]
    return {name: value for name, value in ours.items() if not name.endswith("num_batches_tracked")}


def graph_weights(theirs: Mapping[str, Tensor], prefix: str = "") -> dict[str, Tensor]:
    """Return a graph layer's weights under our names."""
    nodes = theirs["A_res"].shape[1]
    scales = theirs["A_res"].shape[0] // nodes
    weight = _matrix(theirs["mlp.layers.0.weight"])
    return {
        prefix + "residual_adjacency": theirs["A_res"].view(scales, nodes, nodes),
        prefix + "weight": weight.view(len(weight), scales, -1).permute(1, 2, 0),
        prefix + "bias": theirs["mlp.layers.0.bias"],
        **_renamed(theirs, "mlp.layers.1.", prefix + "norm."),
    }


def temporal_weights(theirs: Mapping[str, Tensor], prefix: str = "") -> dict[str, Tensor]:
    """Return a temporal layer's weights under our names: branches that start or end alike are one layer there."""
    ours: dict[str, Tensor] = {}
    for kind in ("weight", "bias"):
        *entries, point = (_matrix(theirs[f"branches.{branch}.0.{kind}"]) for branch in range(6))
        ours[f"entry.{kind}"], ours[f"point.{kind}"] = torch.cat(entries), point
        for branch in range(4):
            ours[f"dilated.{branch}.{kind}"] = theirs[f"branches.{branch}.3.conv.{kind}"]
    last = [*(f"branches.{branch}.3.bn." for branch in range(4)), "branches.4.4.", "branches.5.1."]
    for kind in ("weight", "bias", "running_mean", "running_var"):
        ours[f"entry.norm.{kind}"] = torch.cat([theirs[f"branches.{branch}.1.{kind}"] for branch in range(5)])
        ours[f"norm.{kind}"] = torch.cat([theirs[name + kind] for name in last])
    if "residual.conv.weight" in theirs:
        ours["skip.weight"], ours["skip.bias"] = (
            _matrix(theirs[f"residual.conv.{kind}"]) for kind in ("weight", "bias")
        )
        ours |= _renamed(theirs, "residual.bn.", "skip.norm.")
    return {prefix + name: value for name, value in ours.items()}


def _matrix(parameter: Tensor) -> Tensor:
    """Return a 1 × 1 convolution's parameter as a linear layer's."""
    return parameter[..., 0, 0] if parameter.ndim == 4 else parameter


def _below(weights: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in weights.items() if name.startswith(prefix)}


def _renamed(weights: Mapping[str, Tensor], prefix: str, renamed: str) -> dict[str, Tensor]:
    return {renamed + name: value for name, value in _below(weights, prefix).items()}
