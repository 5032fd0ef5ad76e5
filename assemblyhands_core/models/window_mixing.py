"""One operation: the channels of all joints are mixed, then all joints of all frames in a window with one another.

Summed over scales, (A_k + A_res) X W_k is a product from the left and one from the right. Taken in this order, W first,
each frame meets W once, however many windows it is in; the windows of the result are views into it, as their frames lie
one behind the other, and one matrix holds the A of all scales. What is in between is never held for more than one hand,
unless a gradient needs it. The gradient takes the same way back: each phase of the stride is mixed with the transposed
matrices of the frames of a window that fall on it.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable


def mix_windows(
    features: Float[Tensor, "hand frame joint input"],
    weight: Float[Tensor, "input scale_output"],
    mixing: Float[Tensor, "row column"],
    bias: Float[Tensor, " output"],
    window: int,
    stride: int,
) -> Float[Tensor, "hand window row output"]:
    """Return mixing · [the window's frames of features · weight] + bias, for a window around every `stride`-th frame.

    Args:
        features: Frames of one sequence each; frames of a window that lie outside of it are zero.
        weight: Of all scales, side by side.
        mixing: Rows are what is wanted of a window; columns are (frame of the window, joint, scale).
        bias: Added to every row.
        window: Frames of a window, an odd number.
        stride: Frames from a window to the next.
    """
    features = features.to(weight.dtype)  # in mixed precision layers before it give less than the parameters have
    mixed: Tensor = _MixWindows.apply(features, weight, mixing, bias, window, stride)  # type: ignore[no-untyped-call]
    return mixed


class _MixWindows(Function):
    @staticmethod
    def forward(
        ctx: Any, features: Tensor, weight: Tensor, mixing: Tensor, bias: Tensor, window: int, stride: int
    ) -> Tensor:
        num_windows = -(-features.shape[1] // stride)
        mixed = features.new_empty(len(features), num_windows, len(mixing), len(bias))
        needs_gradient = any(ctx.needs_input_grad)
        products = []
        for hand, target in zip(features, mixed, strict=True):
            product = _product(hand, weight, len(bias), window // 2)
            torch.baddbmm(bias, _each(mixing, num_windows), _windows(product, window, stride), out=target)
            if needs_gradient:
                products.append(product)
        if needs_gradient:
            ctx.save_for_backward(features, weight, mixing, *products)
            ctx.window, ctx.stride = window, stride
        return mixed

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        features, weight, mixing, *products = ctx.saved_tensors
        gradient = gradient.contiguous()
        d_features, d_weight, d_mixing = torch.empty_like(features), torch.zeros_like(weight), torch.zeros_like(mixing)
        taps = mixing.unflatten(1, (ctx.window, -1))
        d_product = features.new_empty(features.shape[1], taps.shape[2], gradient.shape[-1])
        for hand, product in enumerate(products):
            d_mixing.addbmm_(gradient[hand], _windows(product, ctx.window, ctx.stride).mT)
            _mix_back(gradient[hand], taps, ctx.stride, d_product)
            d_rows = d_product.view(-1, weight.shape[1])
            d_weight.addmm_(features[hand].flatten(0, 1).T, d_rows)
            torch.mm(d_rows, weight.T, out=d_features[hand].flatten(0, 1))
        return d_features, d_weight, d_mixing, gradient.sum(dim=(0, 1, 2)), None, None


def _product(
    features: Float[Tensor, "frame joint input"], weight: Tensor, num_outputs: int, reach: int
) -> Float[Tensor, "padded_frame joint_scale output"]:
    """Return features · weight of one hand, with `reach` frames of zeros before and after."""
    frames, joints, _ = features.shape
    product = features.new_empty(frames + 2 * reach, joints * weight.shape[1] // num_outputs, num_outputs)
    product[:reach] = 0
    product[reach + frames :] = 0
    torch.mm(features.flatten(0, 1), weight, out=product[reach : reach + frames].view(-1, weight.shape[1]))
    return product


def _mix_back(
    gradient: Float[Tensor, "window row output"],
    taps: Float[Tensor, "row tap column"],
    stride: int,
    d_frames: Float[Tensor, "frame column output"],
) -> None:
    """Fill the gradient of one hand's frames, given that of its windows.

    Frames whose number leaves the same remainder by the stride are in windows with the same taps.
    """
    reach = taps.shape[1] // 2
    for first in range(stride):
        target = d_frames[first::stride]
        last_window, tap = divmod(first + reach, stride)
        matrices = taps[:, tap::stride].flip(1).permute(2, 1, 0)  # of the first window that the frame is in to the last
        before, after = matrices.shape[1] - 1 - last_window, last_window + len(target) - len(gradient)
        windows = _windows(F.pad(gradient, (0, 0, 0, 0, before, after)), matrices.shape[1], 1)
        torch.bmm(_each(matrices.flatten(1), len(target)), windows, out=target)


def _each(matrix: Tensor, count: int) -> Tensor:
    return matrix.expand(count, *matrix.shape)


def _windows(frames: Float[Tensor, "frame row channel"], window: int, stride: int) -> Tensor:
    """Return a view (window, window's frames × row, channel) of contiguous frames."""
    count, rows, channels = frames.shape
    shape = ((count - window) // stride + 1, window * rows, channels)
    return frames.as_strided(shape, (stride * rows * channels, channels, 1))
