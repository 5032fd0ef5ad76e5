"""What MS-G3D is made of: graph convolutions over frames and over windows of frames, and temporal convolutions.

Everything works on `(hand, frame, joint, channel)`, contiguous: what a formula calls a 1 × 1 convolution is then one
matrix product over all rows, and the frames of a window lie one behind the other, so that windows need no copies.
Source: Liu et al., MS-G3D (CVPR 2020), Sec. 3 and Fig. 3–4.
"""

from typing import Final

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from assemblyhands_core.hands.graphs import scale_matrices, window_adjacency
from assemblyhands_core.models.window_mixing import mix_windows

DILATIONS: Final = (1, 2, 3, 4)
NUM_BRANCHES: Final = len(DILATIONS) + 2
_RESIDUAL_BOUND: Final = 1e-6  # what is learnt beside the graph's own edges starts from next to nothing


class ChannelNorm(nn.BatchNorm1d):
    """Batch norm of the last axis over all others, and a ReLU if there is to be one."""

    def __init__(self, num_channels: int, has_relu: bool = False) -> None:
        super().__init__(num_channels)
        self.has_relu = has_relu

    def forward(self, x: Float[Tensor, "*rows channel"]) -> Float[Tensor, "*rows channel"]:
        rows = super().forward(x.reshape(-1, x.shape[-1]))
        if self.has_relu:
            rows = torch.relu_(rows)  # before it becomes a view: autograd copies what is changed through one
        return rows.view(x.shape)

    def scale_and_shift(self) -> tuple[Float[Tensor, " channel"], Float[Tensor, " channel"]]:
        """Return what it multiplies by and then adds outside of training."""
        assert self.running_mean is not None and self.running_var is not None
        scale = self.weight * torch.rsqrt(self.running_var + self.eps)
        return scale, self.bias - self.running_mean * scale


class NormedLinear(nn.Linear):
    """A linear layer and batch norm, one matrix product outside of training."""

    def __init__(self, num_inputs: int, num_outputs: int) -> None:
        super().__init__(num_inputs, num_outputs)
        self.norm = ChannelNorm(num_outputs)

    def forward(self, x: Float[Tensor, "*rows input"]) -> Float[Tensor, "*rows output"]:
        if self.training:
            normed: Tensor = self.norm(super().forward(x))
            return normed
        scale, shift = self.norm.scale_and_shift()
        return F.linear(x, self.weight * scale[:, None], self.bias * scale + shift)


class GraphConvolution(nn.Module):
    """ReLU of the batch norm of the sum over scales k of (A_k + A_res,k) X W_k: MS-GCN, and with a window MS-G3D's.

    A_k joins nodes that are k edges apart, of a window's copies of the graph if there is one; beyond the graph's
    diameter it is the identity. A_res is learnt. All A stand in one matrix and all W in another: what order is cheaper
    depends on whether channels become more.

    Args:
        num_inputs: Channels of each joint.
        num_outputs: Channels after it.
        is_joined: The graph of one frame.
        num_scales: k goes from 0 to one below.
        window: Frames that are looked at together, an odd number.
        stride: Frames from a window to the next.

    Source: MS-G3D, Eq. 4 (factored) and Eq. 8 (windows).
    """

    def __init__(
        self,
        num_inputs: int,
        num_outputs: int,
        is_joined: Bool[np.ndarray, "joint joint"],
        num_scales: int,
        window: int = 1,
        stride: int = 1,
    ) -> None:
        super().__init__()
        is_joined_in_window = window_adjacency(is_joined, window) if window > 1 else is_joined
        adjacency = torch.tensor(scale_matrices(is_joined_in_window, num_scales), dtype=torch.float32)
        self.window, self.stride = window, stride
        self.adjacency: Tensor
        self.register_buffer("adjacency", adjacency, persistent=False)
        self.residual_adjacency = nn.Parameter(torch.empty_like(adjacency).uniform_(-_RESIDUAL_BOUND, _RESIDUAL_BOUND))
        deviation = (num_scales * num_inputs) ** -0.5
        self.weight = nn.Parameter(deviation * torch.randn(num_scales, num_inputs, num_outputs))
        self.bias = nn.Parameter(torch.zeros(num_outputs))
        self.norm = ChannelNorm(num_outputs, has_relu=True)

    def forward(self, x: Float[Tensor, "hand frame joint input"]) -> Float[Tensor, "hand window joint place output"]:
        """Return the joints at all places of each window; frames outside of the sequence are zero."""
        weight: Tensor = self.weight
        bias: Tensor = self.bias
        if not self.training:
            scale, shift = self.norm.scale_and_shift()
            weight, bias = weight * scale, bias * scale + shift
        copies = (self.window, x.shape[2])
        mixing = (self.adjacency + self.residual_adjacency).view(-1, *copies, *copies)
        is_widening = self.weight.shape[1] < self.weight.shape[2]
        mixed = (self._nodes_first if is_widening else self._channels_first)(x, weight, bias, mixing)
        activated = self.norm(mixed) if self.training else torch.relu_(mixed)
        return activated.view(*mixed.shape[:2], *copies[::-1], -1)

    def _channels_first(
        self,
        x: Float[Tensor, "hand frame joint input"],
        weight: Float[Tensor, "scale input output"],
        bias: Float[Tensor, " output"],
        mixing: Float[Tensor, "scale place joint place joint"],
    ) -> Float[Tensor, "hand window joint_place output"]:
        rows = mixing.permute(2, 1, 3, 4, 0).flatten(2).flatten(0, 1)
        return mix_windows(x, weight.transpose(0, 1).flatten(1), rows, bias, self.window, self.stride)

    def _nodes_first(
        self,
        x: Float[Tensor, "hand frame joint input"],
        weight: Float[Tensor, "scale input output"],
        bias: Float[Tensor, " output"],
        mixing: Float[Tensor, "scale place joint place joint"],
    ) -> Float[Tensor, "hand window joint_place output"]:
        reach = self.window // 2
        windows = F.pad(x, (0, 0, 0, 0, reach, reach)).unfold(1, self.window, self.stride)
        columns = mixing.permute(4, 3, 2, 1, 0).flatten(2).flatten(0, 1)
        mixed = windows.transpose(2, 3).flatten(3) @ columns
        rows = mixed.view(*mixed.shape[:3], -1, len(weight)).permute(0, 1, 3, 4, 2).flatten(3)
        return F.linear(rows, weight.flatten(0, 1).T, bias)


class WindowGraphConvolution(nn.Module):
    """A graph convolution over windows whose frames are collapsed to one: MS-G3D's module proper.

    Args:
        num_inputs: Channels of each joint.
        width: Channels within the window.
        num_outputs: Channels after it.
        is_joined: The graph of one frame.
        num_scales: Of the graph convolution.
        window: Frames of a window.
        stride: Frames from a window to the next.

    Source: MS-G3D, Sec. 3.3–3.4.
    """

    def __init__(
        self,
        num_inputs: int,
        width: int,
        num_outputs: int,
        is_joined: Bool[np.ndarray, "joint joint"],
        num_scales: int,
        window: int,
        stride: int,
    ) -> None:
        super().__init__()
        self.graph = GraphConvolution(num_inputs, width, is_joined, num_scales, window, stride)
        self.collapse = NormedLinear(window * width, num_outputs)

    def forward(self, x: Float[Tensor, "hand frame joint input"]) -> Float[Tensor, "hand window joint output"]:
        collapsed: Tensor = self.collapse(self.graph(x).flatten(3))
        return collapsed


class TemporalConvolutions(nn.Module):
    """Six branches side by side along time, added to what came in: four dilations, the maximum of three, one frame.

    Layers with which branches begin or end alike are one layer here.

    Args:
        num_inputs: Channels of each joint.
        num_outputs: Channels after it, a sixth from each branch.
        stride: Frames from one to the next.
        has_relu: Whether a ReLU ends it.

    Raises:
        ValueError: `num_outputs` is no multiple of six.

    Source: MS-G3D, Fig. 3(d).
    """

    def __init__(self, num_inputs: int, num_outputs: int, stride: int = 1, has_relu: bool = True) -> None:
        super().__init__()
        width, rest = divmod(num_outputs, NUM_BRANCHES)
        if rest:
            raise ValueError(f"{num_outputs} channels cannot be shared by {NUM_BRANCHES} branches: choose a multiple.")
        self.width, self.stride, self.has_relu = width, stride, has_relu
        self.entry = NormedLinear(num_inputs, (NUM_BRANCHES - 1) * width)
        self.dilated = nn.ModuleList(
            nn.Conv2d(width, width, (3, 1), (stride, 1), (dilation, 0), (dilation, 1)) for dilation in DILATIONS
        )
        self.point = nn.Linear(num_inputs, width)
        self.norm = ChannelNorm(num_outputs)
        has_skip = stride > 1 or num_inputs != num_outputs
        self.skip = NormedLinear(num_inputs, num_outputs) if has_skip else nn.Identity()

    def forward(self, x: Float[Tensor, "hand frame joint input"]) -> Float[Tensor, "hand later_frame joint output"]:
        """Return every `stride`-th frame."""
        *entries, last = (_as_images(part.relu()) for part in self.entry(x).split(self.width, dim=-1))
        branches = [layer(part) for layer, part in zip(self.dilated, entries, strict=True)]
        branches.append(F.max_pool2d(last, (3, 1), (self.stride, 1), (1, 0)))
        x = x[:, :: self.stride].contiguous()
        joined = torch.cat([*(branch.permute(0, 2, 3, 1) for branch in branches), self.point(x)], dim=-1)
        added: Tensor = self.norm(joined) + self.skip(x)
        return torch.relu_(added) if self.has_relu else added


def _as_images(x: Float[Tensor, "hand frame joint channel"]) -> Float[Tensor, "hand channel frame joint"]:
    """Return a view that convolutions take as it lies in memory, channels last."""
    return x.permute(0, 3, 1, 2)
