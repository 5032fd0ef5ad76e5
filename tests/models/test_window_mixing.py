"""Mixing of windows: a ramp by hand, the reference's windows, the gradient, and what is in between in float64."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from assemblyhands_core.models.window_mixing import mix_windows

SHAPES = [(1, 1, 4), (3, 1, 5), (3, 2, 4), (3, 2, 5), (5, 2, 6), (5, 2, 3), (5, 3, 7), (3, 3, 2), (5, 1, 1)]


def windows(features: Tensor, window: int, stride: int) -> Tensor:
    """The frames of each window, by what mixing does with the identity."""
    identity = torch.eye(window * features.shape[2], dtype=features.dtype)
    channels = torch.eye(features.shape[3], dtype=features.dtype)
    return mix_windows(features, channels, identity, features.new_zeros(features.shape[3]), window, stride)


def test_windows_of_a_ramp() -> None:
    ramp = torch.arange(1.0, 6.0).view(1, 5, 1, 1)
    assert windows(ramp, 3, 1)[0, :, :, 0].tolist() == [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5, 0]]
    assert windows(ramp, 5, 2)[0, :, :, 0].tolist() == [[0, 0, 1, 2, 3], [1, 2, 3, 4, 5], [3, 4, 5, 0, 0]]
    assert windows(ramp, 1, 3)[0, :, :, 0].tolist() == [[1], [4]]


@pytest.mark.parametrize(("window", "stride"), [(3, 1), (5, 1), (3, 2), (5, 2)])
def test_windows_of_the_reference_program(golden_dir: Path, window: int, stride: int) -> None:
    with np.load(golden_dir / "msg3d_blocks.npz") as golden:
        x, y = (torch.from_numpy(golden[f"unfold_w{window}_s{stride}_d1/{name}"]) for name in "xy")
    assert torch.equal(windows(x.permute(0, 2, 3, 1).contiguous(), window, stride), y.permute(0, 2, 3, 1))


def random_arguments(window: int, frames: int) -> tuple[Tensor, ...]:
    """Two hands of four joints, three channels that become two scales of five, six rows, in float64."""
    generator = torch.Generator().manual_seed(0)
    shapes = ((2, frames, 4, 3), (3, 2 * 5), (6, window * 4 * 2), (5,))
    return tuple(torch.randn(*shape, generator=generator, dtype=torch.float64).requires_grad_() for shape in shapes)


@pytest.mark.parametrize(("window", "stride", "frames"), SHAPES)
def test_mixing_is_the_plain_sum(window: int, stride: int, frames: int) -> None:
    features, weight, mixing, bias = random_arguments(window, frames)
    reach = window // 2
    padded = F.pad(features, (0, 0, 0, 0, reach, reach))
    expected = [
        torch.einsum(
            "rtvs,htvi,iso->hro", mixing.view(6, window, 4, 2), padded[:, k : k + window], weight.view(3, 2, 5)
        )
        for k in range(0, frames, stride)
    ]
    found = mix_windows(features, weight, mixing, bias, window, stride)
    torch.testing.assert_close(found, torch.stack(expected, dim=1) + bias, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("window", "stride", "frames"), SHAPES)
def test_its_gradient_is_that_of_small_steps(window: int, stride: int, frames: int) -> None:
    arguments = random_arguments(window, frames)
    assert torch.autograd.gradcheck(lambda *inputs: mix_windows(*inputs, window, stride), arguments)


def test_nothing_is_kept_where_no_gradient_is_needed() -> None:
    with torch.no_grad():
        assert mix_windows(*random_arguments(3, 4), 3, 1).grad_fn is None
