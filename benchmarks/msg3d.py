"""MS-G3D: ours against the textbook form of the same network with the same weights, side by side in one run.

    python benchmarks/msg3d.py [--repeats 5] [--threads 2] [--frames 96]

Time of a forward pass and of a training step without the optimiser (best of the repeats, taken in turn, because other
work on the machine only slows down), and the greatest difference of logits relative to the greatest logit. The textbook
form is eager PyTorch, one layer a formula: windows are unfolded, scales are one einsum, each branch is a convolution.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from assemblyhands_core.models.msg3d import BASE, MSG3D, SMALL, MSG3DConfig

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from textbook_msg3d import TextbookMSG3D, our_weights

SIZES = {"base": (BASE, 4), "small": (SMALL, 16)}  # and samples


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=96)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    print(f"{options.frames} frames, {options.threads} threads")
    for name, (config, samples) in SIZES.items():
        poses = torch.randn(samples, 3, options.frames, 21, 2)
        for work, pass_of in (("forward", forward), ("training step", training_step)):
            compare(f"{name:5} ({samples:2} samples): {work:13}", pass_of, networks(config), poses, options.repeats)


def networks(config: MSG3DConfig) -> tuple[nn.Module, nn.Module]:
    """Return the textbook form and ours with its weights."""
    textbook, ours = TextbookMSG3D(config), MSG3D(config)
    ours.load_state_dict(our_weights(textbook.state_dict()), strict=False)
    return textbook, ours


def forward(network: nn.Module, poses: Tensor) -> Tensor:
    with torch.no_grad():
        logits: Tensor = network.eval()(poses)
    return logits


def training_step(network: nn.Module, poses: Tensor) -> Tensor:
    network.train().zero_grad()
    logits: Tensor = network(poses)
    F.cross_entropy(logits, torch.arange(len(poses)) % logits.shape[1]).backward()
    return logits.detach()


def compare(
    title: str,
    pass_of: Callable[[nn.Module, Tensor], Tensor],
    both: tuple[nn.Module, nn.Module],
    poses: Tensor,
    repeats: int,
) -> None:
    expected, found = (pass_of(network, poses) for network in both)
    difference = ((found - expected).abs().max() / expected.abs().max()).item()
    seconds: list[list[float]] = [[], []]
    for _ in range(repeats):
        for network, taken in zip(both, seconds, strict=True):
            begin = time.perf_counter()
            pass_of(network, poses)
            taken.append(time.perf_counter() - begin)
    textbook_s, ours_s = (min(taken) for taken in seconds)
    print(
        f"{title} textbook {1000 * textbook_s:7.1f} ms, ours {1000 * ours_s:7.1f} ms, "
        f"ratio {textbook_s / ours_s:.2f}, greatest difference {difference:.1e}"
    )


if __name__ == "__main__":
    main()
