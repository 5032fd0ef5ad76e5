"""Decode throughput of `VideoReader` against `cv2.VideoCapture`, side by side in one run.

    python benchmarks/decode.py [VIDEO] [--frames 360] [--repeats 3]

Without a video a 1080p H.264 clip (60 Hz, B-frames, a key frame every second) is made. Every case is run in turn with
its rival, and the best of the repeats is shown, because other work on the machine only ever slows a run down. Frames
per second of processor time (all threads) are shown beside those of the clock, as busy neighbours disturb them less.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from assemblyhands_core.data.video import VideoReader

CHUNK_FRAMES = 128
REDUCED_SIDE_PX = 640


def make_clip(path: Path, num_frames: int) -> None:
    """Encode a drifting, blurred noise texture: as hard to predict as a hand-held scene, at a camera's bit rate."""
    rng = np.random.default_rng(0)
    texture = cv2.resize(
        rng.integers(0, 255, (700, 1000, 3), dtype=np.uint8), (4000, 2800), interpolation=cv2.INTER_CUBIC
    )
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(
            "libx264", rate=60, options={"preset": "veryfast", "crf": "23", "g": "60", "bf": "2"}
        )
        stream.width, stream.height, stream.pix_fmt = 1920, 1080, "yuv420p"
        for index in range(num_frames):
            top, left = index % 1700, (2 * index) % 2000
            picture = np.ascontiguousarray(texture[top : top + 1080, left : left + 1920])
            picture = cv2.add(picture, rng.integers(0, 6, (1080, 1920, 1), dtype=np.uint8).repeat(3, axis=2))
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, 60)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def chunks(num_frames: int) -> list[range]:
    """Chunks in random order, as workers ask for them."""
    starts = np.random.default_rng(1).permutation(range(0, num_frames, CHUNK_FRAMES))
    return [range(int(start), min(int(start) + CHUNK_FRAMES, num_frames)) for start in starts]


def read_ours(path: Path, parts: list[range], max_side_px: int | None, threads: int) -> int:
    """Open once per chunk, as a shard does, and read."""
    count = 0
    for part in parts:
        reader = VideoReader(path, threads=threads)
        count += sum(1 for _ in reader.frames(part.start, len(part), max_side_px=max_side_px))
    return count


def read_opencv(path: Path, parts: list[range], max_side_px: int | None, threads: int) -> int:
    """The same through OpenCV, converted to RGB as detectors want it."""
    count = 0
    for part in parts:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, threads])
        if part.start:
            capture.set(cv2.CAP_PROP_POS_FRAMES, part.start)
        for _ in part:
            is_read, picture = capture.read()
            if not is_read:
                break
            if max_side_px is not None:
                scale = max_side_px / max(picture.shape[:2])
                picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
            count += 1
        capture.release()
    return count


def throughput(read: Callable[..., int], *args: Any) -> np.ndarray:
    """Frames per second of the clock and of processor time."""
    wall, cpu = time.perf_counter(), time.process_time()
    count = read(*args)
    return count / np.array([time.perf_counter() - wall, time.process_time() - cpu])


def rows(path: Path, num_frames: int, repeats: int) -> Iterator[tuple[str, int, np.ndarray]]:
    """Yield case, threads and the best throughputs: ours and OpenCV's (rows), by clock and by processor (columns)."""
    whole, random = [range(num_frames)], chunks(num_frames)
    cases = [
        ("whole clip, full size", whole, None),
        (f"chunks of {CHUNK_FRAMES} in random order, full size", random, None),
        (f"whole clip, reduced to {REDUCED_SIDE_PX} px", whole, REDUCED_SIDE_PX),
        (f"chunks of {CHUNK_FRAMES}, reduced to {REDUCED_SIDE_PX} px", random, REDUCED_SIDE_PX),
    ]
    for threads in (1, 2):
        for name, parts, side in cases:
            best = np.zeros((2, 2))
            for _ in range(repeats):
                for i, read in enumerate((read_ours, read_opencv)):
                    best[i] = np.maximum(best[i], throughput(read, path, parts, side, threads))
            yield name, threads, best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", nargs="?", type=Path)
    parser.add_argument("--frames", type=int, default=256)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.video or Path(folder) / "clip.mp4"
        if arguments.video is None:
            make_clip(path, arguments.frames)
        reader = VideoReader(path)
        num_frames = min(arguments.frames, reader.num_frames)
        print(f"{path.name}: {reader.width_px}x{reader.height_px}, {num_frames} frames, best of {arguments.repeats}")
        columns = "{:46}{:>7} |{:>9}{:>8}{:>7} |{:>10}{:>8}{:>7}"
        print(columns.format("", "threads", "frames/s", "OpenCV", "ratio", "per CPU-s", "OpenCV", "ratio"))
        for name, threads, (ours, opencv) in rows(path, num_frames, arguments.repeats):
            values = np.stack([ours, opencv, ours / opencv], axis=1).ravel()
            print(columns.format(name, threads, *(f"{value:.{1 + i % 3 // 2}f}" for i, value in enumerate(values))))


if __name__ == "__main__":
    main()
