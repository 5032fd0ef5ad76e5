"""V2V: a 3D encoder-decoder from feature volumes to heatmaps of joints, in the paper's size and a slim one.

Source: paper, Sec. 3.1; Moon et al., V2V-PoseNet (CVPR 2018), Fig. 4, in the form that Iskakov et al. (ICCV 2019) use:
11,944,485 parameters from 32 channels to 21 joints.
"""

import itertools
from collections.abc import Sequence
from typing import Final, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

V2VSize = Literal["slim", "reference"]

REFERENCE_WIDTHS: Final = (32, 64, 128, 128, 128, 128)
SLIM_WIDTHS: Final = (24, 48, 72)
_ALIGNMENT: Final = 8  # convolutions whose channels are a multiple of this run 3–4 times as fast on a CPU


class ConvolutionBlock(nn.Sequential):
    """Convolution, batch norm, ReLU; the size stays unless a stride is given."""

    def __init__(self, num_inputs: int, num_outputs: int, kernel: int, stride: int = 1) -> None:
        convolution = nn.Conv3d(num_inputs, num_outputs, kernel, stride, padding=(kernel - 1) // 2)
        super().__init__(convolution, nn.BatchNorm3d(num_outputs), nn.ReLU(inplace=True))


class UpsamplingBlock(nn.Sequential):
    """Transposed convolution to twice the size, batch norm, ReLU."""

    def __init__(self, num_inputs: int, num_outputs: int) -> None:
        convolution = nn.ConvTranspose3d(num_inputs, num_outputs, kernel_size=2, stride=2)
        super().__init__(convolution, nn.BatchNorm3d(num_outputs), nn.ReLU(inplace=True))


class ResidualBlock(nn.Module):
    """Two 3³ convolutions beside the identity, or beside a 1³ convolution where the width changes."""

    def __init__(self, num_inputs: int, num_outputs: int) -> None:
        super().__init__()
        self.branch = nn.Sequential(
            *ConvolutionBlock(num_inputs, num_outputs, kernel=3),
            nn.Conv3d(num_outputs, num_outputs, 3, padding=1),
            nn.BatchNorm3d(num_outputs),
        )
        self.skip = nn.Sequential()
        if num_inputs != num_outputs:
            self.skip = nn.Sequential(nn.Conv3d(num_inputs, num_outputs, 1), nn.BatchNorm3d(num_outputs))

    def forward(self, volume: Float[Tensor, "batch channel x y z"]) -> Float[Tensor, "batch output x y z"]:
        return torch.relu(self.branch(volume) + self.skip(volume))


class EncoderDecoder(nn.Module):
    """Halve the size once per width after the first, and come back, adding what was seen at each size on the way down.

    Args:
        widths: Channels at full size, at half of it, and so on.
        num_blocks: Residual blocks at the smallest size.
        has_skip_blocks: Whether a residual block lies on the way across.
        has_decoder_blocks: Whether a residual block comes before each upsampling.
    """

    def __init__(
        self, widths: Sequence[int], num_blocks: int, has_skip_blocks: bool = True, has_decoder_blocks: bool = True
    ) -> None:
        super().__init__()
        pairs = list(itertools.pairwise(widths))
        self.pool = nn.MaxPool3d(2)
        self.skips = nn.ModuleList(_block(width, has_skip_blocks) for width in widths[:-1])
        self.encoders = nn.ModuleList(ResidualBlock(wide, deep) for wide, deep in pairs)
        self.middle = nn.Sequential(*(ResidualBlock(widths[-1], widths[-1]) for _ in range(num_blocks)))
        self.decoders = nn.ModuleList(_block(deep, has_decoder_blocks) for _, deep in pairs)
        self.upsamplings = nn.ModuleList(UpsamplingBlock(deep, wide) for wide, deep in pairs)

    def forward(self, volume: Float[Tensor, "batch channel x y z"]) -> Float[Tensor, "batch channel x y z"]:
        across = []
        for skip, encoder in zip(self.skips, self.encoders, strict=True):
            across.append(skip(volume))
            volume = encoder(self.pool(volume))
        volume = self.middle(volume)
        for decoder, upsampling in zip(reversed(self.decoders), reversed(self.upsamplings), strict=True):
            volume = upsampling(decoder(volume)) + across.pop()
        return volume


class ReferenceV2V(nn.Module):
    """The network of the reference, five poolings deep.

    Args:
        num_channels: Channels of the feature volume.
        num_joints: Heatmaps.
    """

    divisor: Final = 32

    def __init__(self, num_channels: int, num_joints: int) -> None:
        super().__init__()
        width = REFERENCE_WIDTHS[0]
        self.front = nn.Sequential(
            ConvolutionBlock(num_channels, 16, kernel=7),
            ResidualBlock(16, width),
            ResidualBlock(width, width),
            ResidualBlock(width, width),
        )
        self.encoder_decoder = EncoderDecoder(REFERENCE_WIDTHS, num_blocks=1)
        self.back = nn.Sequential(
            ResidualBlock(width, width),
            ConvolutionBlock(width, width, kernel=1),
            ConvolutionBlock(width, width, kernel=1),
        )
        self.output = nn.Conv3d(width, num_joints, 1)
        self.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]

    def forward(self, volume: Float[Tensor, "batch channel x y z"]) -> Float[Tensor, "batch joint x y z"]:
        """Return logits of the same size; sides must be a multiple of `divisor`."""
        _check_sides(volume, self.divisor)
        heatmaps: Tensor = self.output(self.back(self.encoder_decoder(self.front(volume))))
        return heatmaps


class SlimV2V(nn.Module):
    """A network for laptops: it works at half the size and below, and adds a look at the full volume at the end.

    Args:
        num_channels: Channels of the feature volume.
        num_joints: Heatmaps.
    """

    divisor: Final = 8

    def __init__(self, num_channels: int, num_joints: int) -> None:
        super().__init__()
        self.num_joints = num_joints
        width, num_outputs = SLIM_WIDTHS[0], -(-num_joints // _ALIGNMENT) * _ALIGNMENT
        self.shrink = nn.Sequential(
            nn.Conv3d(num_channels, width, kernel_size=2, stride=2), nn.BatchNorm3d(width), nn.ReLU(inplace=True)
        )
        self.front = ResidualBlock(width, width)
        self.encoder_decoder = EncoderDecoder(SLIM_WIDTHS, num_blocks=1, has_skip_blocks=False)
        self.upsampling = UpsamplingBlock(width, width)
        self.skip = nn.Conv3d(num_channels, width, 1)
        self.output = nn.Conv3d(width, num_outputs, 1)
        self.to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]

    def forward(self, volume: Float[Tensor, "batch channel x y z"]) -> Float[Tensor, "batch joint x y z"]:
        """Return logits of the same size; sides must be a multiple of `divisor`."""
        _check_sides(volume, self.divisor)
        volume = volume.contiguous(memory_format=torch.channels_last_3d)
        deep = self.upsampling(self.encoder_decoder(self.front(self.shrink(volume))))
        heatmaps: Tensor = self.output(torch.relu(deep + self.skip(volume)))
        return heatmaps[:, : self.num_joints]


def build_v2v(size: V2VSize, num_channels: int, num_joints: int) -> ReferenceV2V | SlimV2V:
    """Return a V2V network of the given size with random weights."""
    return (ReferenceV2V if size == "reference" else SlimV2V)(num_channels, num_joints)


def _block(width: int, is_residual: bool) -> nn.Module:
    return ResidualBlock(width, width) if is_residual else nn.Identity()


def _check_sides(volume: Float[Tensor, "batch channel x y z"], divisor: int) -> None:
    if any(side % divisor for side in volume.shape[2:]):
        raise ValueError(
            f"A volume of {tuple(volume.shape[2:])} voxels cannot be halved evenly: choose sides that are "
            f"multiples of {divisor}."
        )
