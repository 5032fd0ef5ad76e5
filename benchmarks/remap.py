"""Undistorting two hand regions of a 1080p view: shared coarse grid, exact maps per region, and the full frame.

    python benchmarks/remap.py [--frames 50]

Regions move from frame to frame, so their maps are made anew each time, while the maps of a full frame are made once.
"""

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import crop_camera, rectified, source_pixels
from assemblyhands_core.geometry.distortion import OpenCVLens
from assemblyhands_core.geometry.regions import RemapGrid, remap

LENS = OpenCVLens(k1=-0.13, k2=0.12, k3=-0.02, p1=-6e-4, p2=7e-4)
SOURCE = Camera("c", 1920, 1080, 1192.0, 1193.0, 957.0, 530.0, LENS, np.eye(4))
TARGET = rectified(SOURCE)
SIZE_PX = 256


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=50)
    num_frames = parser.parse_args().frames
    cv2.setNumThreads(1)
    generator = np.random.default_rng(0)
    image = generator.integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    crops = [[_random_crop(generator) for _ in range(2)] for _ in range(num_frames)]
    begin = time.perf_counter()
    grid = RemapGrid.build(SOURCE, TARGET)
    print(f"grid every {grid.step_px:g} px, made once per camera: {(time.perf_counter() - begin) * 1e3:.0f} ms")
    residual_px = grid.residual_px(SOURCE, TARGET)
    print(f"largest error of its maps: {residual_px:.4f} px; in these regions {_error(grid, crops):.4f} px")
    full = grid.window(TARGET)
    ways: dict[str, Callable[[list[Camera]], object]] = {
        "two regions, maps from the coarse grid": lambda pair: [remap(image, *grid.window(crop)) for crop in pair],
        "two regions, exact maps": lambda pair: [remap(image, *_exact_maps(crop)) for crop in pair],
        "full frame, maps made once": lambda pair: remap(image, *full),
    }
    milliseconds = {name: _milliseconds(way, crops) for name, way in ways.items()}
    fastest = min(milliseconds.values())
    for name, value in milliseconds.items():
        print(f"{name}: {value:.2f} ms per view, {value / fastest:.1f} x")


def _random_crop(generator: np.random.Generator) -> Camera:
    center = generator.uniform((300, 250), (1600, 850))
    return crop_camera(TARGET, center, generator.uniform(180, 380), SIZE_PX)


def _exact_pixels(crop: Camera) -> npt.NDArray[np.floating]:
    x, y = np.meshgrid(np.arange(crop.width_px, dtype=float), np.arange(crop.height_px, dtype=float))
    return source_pixels(SOURCE, crop, np.stack((x, y), axis=-1))


def _exact_maps(crop: Camera) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    pixels = _exact_pixels(crop).astype(np.float32)
    return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])


def _error(grid: RemapGrid, crops: list[list[Camera]]) -> float:
    return max(
        float(np.linalg.norm(np.stack(grid.window(crop), axis=-1) - _exact_pixels(crop), axis=-1).max())
        for pair in crops[:10]
        for crop in pair
    )


def _milliseconds(way: Callable[[list[Camera]], object], crops: list[list[Camera]]) -> float:
    way(crops[0])
    begin = time.perf_counter()
    for pair in crops:
        way(pair)
    return (time.perf_counter() - begin) / len(crops) * 1e3


if __name__ == "__main__":
    main()
