"""Videos of which each picture carries its own index as bars."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from assemblyhands_core.data.video import VideoReader

NUM_BITS, BAR_PX, HEIGHT_PX = 8, 16, 48
WIDTH_PX = NUM_BITS * BAR_PX
NUM_FRAMES = 70
FASTSTART = {"movflags": "+faststart"}

GOPS = {
    "b_frames": {"g": "12", "bf": "3", "x264-params": "b-adapt=0"},
    "no_b_frames": {"g": "10", "bf": "0"},
    "intra_only": {"g": "1"},
    "one_gop": {"g": "250", "bf": "2"},
    "pyramid": {"g": "16", "bf": "7", "x264-params": "b-adapt=0:b-pyramid=normal:ref=4"},
    "open_gop": {"g": "12", "bf": "3", "x264-params": "open-gop=1:b-adapt=0:scenecut=0"},
    "intra_refresh": {"g": "20", "x264-params": "intra-refresh=1"},
}


def numbered_picture(index: int, height_px: int = HEIGHT_PX) -> np.ndarray:
    """Bars: bit b of the index is white or black; the lower half drifts, so that frames predict each other."""
    bits = (index >> np.arange(NUM_BITS)) & 1
    picture = np.repeat(np.repeat(bits * 255, BAR_PX)[None], height_px, axis=0).astype(np.uint8)
    picture[height_px // 2 :] = (np.arange(WIDTH_PX) * 2 + index * 3) % 256
    return np.repeat(picture[..., None], 3, axis=2)


def number_in(picture: np.ndarray) -> int:
    rows = picture[: picture.shape[0] // 4, :, 0].mean(axis=0)
    return int(((rows.reshape(NUM_BITS, -1).mean(axis=1) > 128) << np.arange(NUM_BITS)).sum())


def write_numbered(
    path: Path,
    options: dict[str, str],
    pts: Any = range(NUM_FRAMES),
    codec: str = "libx264",
    container_options: dict[str, str] | None = None,
    rate: int = 30,
) -> Path:
    """Encode one numbered picture per given timestamp (in frames of `rate`)."""
    with av.open(str(path), "w", options=container_options or {}) as container:
        stream: Any = container.add_stream(codec, rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        for index, stamp in enumerate(pts):
            frame = av.VideoFrame.from_ndarray(numbered_picture(index), format="rgb24")
            frame.pts, frame.time_base = stamp, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def numbers(reader: VideoReader, *args: Any, **kwargs: Any) -> list[tuple[int, int]]:
    return [(index, number_in(picture)) for index, picture in reader.frames(*args, **kwargs)]


def same(*indices: int) -> list[tuple[int, int]]:
    return [(index, index) for index in indices]
