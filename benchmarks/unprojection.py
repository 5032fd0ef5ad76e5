"""Unprojection and fusion of views: the fused loop against the plain loop over views, side by side in one run.

    python benchmarks/unprojection.py [--repeats 5] [--threads 2] [--views 8] [--channels 32]

Time of forward and backward (best of the repeats, taken in turn, because other work on the machine only slows down)
and peak memory: how far the resident memory of a process of its own rises above what it held before, forward and
backward. Also shown: one training step of the small network, 4 hands × 4 views.
"""

import argparse
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from assemblyhands_core.geometry.volumes import cube_points_world_mm, unproject_features
from assemblyhands_core.models.fused_unprojection import fused_unproject_features
from assemblyhands_core.models.mvexonet import SMALL, MVExoNet

Fusion = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
FORMS: dict[str, Fusion] = {"plain": unproject_features, "fused": fused_unproject_features}
DISTANCE_MM, FIELD_MM = 800.0, 330.0
MIB = 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--channels", type=int, default=32)
    parser.add_argument("--memory-of", choices=FORMS, help=argparse.SUPPRESS)
    parser.add_argument("--voxels", type=int, default=32, help=argparse.SUPPRESS)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.memory_of:
        print(peak_bytes(FORMS[options.memory_of], *case(options.views, options.channels, options.voxels)))
        return
    for num_voxels in (32, 64):
        compare(options, num_voxels)
    print(f"training step of the small network, 4 hands x 4 views: {training_step_s(options.repeats):.2f} s")


def compare(options: argparse.Namespace, num_voxels: int) -> None:
    arguments = case(options.views, options.channels, num_voxels)
    plain, fused = (both(form, *arguments) for form in FORMS.values())
    errors = [(one - other).abs().max().item() for one, other in zip(plain, fused, strict=True)]
    seconds: dict[str, list[float]] = {name: [] for name in FORMS}
    for _ in range(options.repeats):
        for name, form in FORMS.items():
            begin = time.perf_counter()
            both(form, *arguments)
            seconds[name].append(time.perf_counter() - begin)
    best = {name: min(values) for name, values in seconds.items()}
    memory = {name: measured_bytes(name, options, num_voxels) for name in FORMS}
    print(f"{options.views} views x {options.channels} channels, {num_voxels}^3 voxels, {options.threads} threads")
    for name in FORMS:
        print(f"  {name}: {best[name] * 1e3:.0f} ms forward and backward, {memory[name] / MIB:.0f} MiB")
    print(
        f"  plain / fused: {best['plain'] / best['fused']:.1f} x time, {memory['plain'] / memory['fused']:.1f} x memory"
    )
    print(f"  largest difference: {errors[0]:.1e} of values, {errors[1]:.1e} of gradients")


def case(num_views: int, num_channels: int, num_voxels: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """One hand; maps as large as the cube has voxels, as the networks have them, in the encoder's memory order."""
    generator = torch.Generator().manual_seed(0)
    maps = torch.randn(1, num_views, num_voxels, num_voxels, num_channels, generator=generator)
    rng = np.random.default_rng(0)
    matrices = np.array([[matrix(rng, num_voxels) for _ in range(num_views)]])
    points = cube_points_world_mm(torch.zeros(1, 3), 300.0, num_voxels)
    used = torch.ones(1, num_views, dtype=torch.bool)
    return maps.permute(0, 1, 4, 2, 3).requires_grad_(), torch.tensor(matrices).float(), points, used


def matrix(rng: np.random.Generator, size_px: int) -> np.ndarray:
    """A camera in a random direction that looks at the middle of the cube."""
    forward, up = rng.normal(size=(2, 3))
    forward /= np.linalg.norm(forward)
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    pose = np.column_stack((np.stack((right, np.cross(forward, right), forward)), (0.0, 0.0, DISTANCE_MM)))
    focal_px, center_px = size_px / FIELD_MM * DISTANCE_MM, (size_px - 1) / 2
    return np.array([[focal_px, 0, center_px], [0, focal_px, center_px], [0, 0, 1]]) @ pose


def both(form: Fusion, features: Tensor, P: Tensor, points: Tensor, used: Tensor) -> tuple[Tensor, Tensor]:
    """Forward and backward, with a gradient in the memory order of the 3D network."""
    volume = form(features, P, points, used)
    upstream = torch.ones_like(volume, memory_format=torch.channels_last_3d)
    return volume.detach(), torch.autograd.grad(volume, features, upstream)[0]


def measured_bytes(name: str, options: argparse.Namespace, num_voxels: int) -> int:
    command = [sys.executable, __file__, "--memory-of", name, "--voxels", str(num_voxels)]
    command += ["--views", str(options.views), "--channels", str(options.channels), "--threads", str(options.threads)]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1])


def peak_bytes(form: Fusion, features: Tensor, P: Tensor, points: Tensor, used: Tensor) -> int:
    """Rise of resident memory while the form runs, looked at every half millisecond; code is loaded before."""
    few = points[:, :2, :2, :2].contiguous()
    both(form, features, P, few, used)
    before, highest, done = resident_bytes(), [0], threading.Event()

    def watch() -> None:
        while not done.is_set():
            highest[0] = max(highest[0], resident_bytes())
            time.sleep(5e-4)

    watcher = threading.Thread(target=watch)
    watcher.start()
    results = both(form, features, P, points, used)
    highest[0] = max(highest[0], resident_bytes())
    done.set()
    watcher.join()
    del results
    return highest[0] - before


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def training_step_s(repeats: int) -> float:
    torch.manual_seed(0)
    network, rng = MVExoNet(SMALL), np.random.default_rng(1)
    P = torch.tensor(np.array([[matrix(rng, SMALL.image_size_px) for _ in range(4)] for _ in range(4)])).float()
    inputs = torch.rand(4, 4, 3, 128, 128), P, torch.ones(4, 4).bool(), torch.zeros(4, 3), torch.arange(4) % 2 == 1
    true_mm, is_valid = torch.randn(4, 21, 3) * 40, torch.ones(4, 21).bool()
    optimizer, seconds = torch.optim.AdamW(network.parameters()), []
    for _ in range(1 + repeats):
        begin = time.perf_counter()
        loss = network.loss(network(*inputs), true_mm, is_valid, inputs[3], inputs[4])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        seconds.append(time.perf_counter() - begin)
    return min(seconds)


if __name__ == "__main__":
    main()
