"""Frame-exact reading of video, and where its writer is found.

A frame's index is the rank of its presentation timestamp among those of its stream, counted from 0, so that B-frames
(stored in decoding order), a non-zero start time and edit lists cannot shift it. Pixels are delivered as players show
them: display rotation is applied, sample aspect ratio is not.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from av.video.reformatter import Interpolation
from numpy.typing import NDArray

from assemblyhands_core.data.video_stream import Timeline, VideoError, VideoReason, decoded_from, opened, read_timeline
from assemblyhands_core.data.video_writer import VideoWriter

__all__ = ["VideoError", "VideoInfo", "VideoReader", "VideoReason", "VideoWriter", "probe"]

MAX_DECODER_THREADS = 4  # beyond this 1080p H.264 gains little, and shards that run side by side starve each other


@dataclass(frozen=True)
class VideoInfo:
    """What a video file holds, measured rather than believed.

    Attributes:
        width_px, height_px: size of a decoded frame, display rotation applied.
        num_frames: distinct presentation timestamps of complete packets.
        num_frames_header: what the container claims; 0 where it says nothing.
        rate_hz: mean frame rate over the stream.
        is_constant_rate: whether all frames are equally far apart.
        codec, pixel_format: FFmpeg's names.
        start_s, duration_s: presentation time of the first frame; time from it to the end of the last one.
        rotation_deg: counter-clockwise display rotation (0, 90, 180 or 270), already in width and height.
        is_truncated: whether the file ends before what its header promises.
    """

    width_px: int
    height_px: int
    num_frames: int
    num_frames_header: int
    rate_hz: Fraction
    is_constant_rate: bool
    codec: str
    pixel_format: str
    start_s: float
    duration_s: float
    rotation_deg: int
    is_truncated: bool


def probe(path: Path | str) -> VideoInfo:
    """Audit a video: read all its packets (nothing but its first sound frame is decoded).

    Raises:
        VideoError: the file is missing, no video, without frames, or no frame of it can be decoded.
    """
    path = Path(path)
    timeline = read_timeline(path, use_header=False)
    with opened(path) as (_, stream):
        tick_s = Fraction(stream.time_base)
        num_frames_header, codec = int(stream.frames), str(stream.codec_context.name)
    frame = _first_frame(path, timeline)
    gap_s = _mean_gap_s(timeline, tick_s)
    width_px, height_px = _shown_size(frame.width, frame.height, frame.rotation)
    return VideoInfo(
        width_px=width_px,
        height_px=height_px,
        num_frames=len(timeline.pts),
        num_frames_header=num_frames_header,
        rate_hz=(1 / gap_s).limit_denominator(1001),
        is_constant_rate=_is_constant_rate(timeline.pts),
        codec=codec,
        pixel_format=str(frame.format.name),
        start_s=float(int(timeline.pts[0]) * tick_s),
        duration_s=float(len(timeline.pts) * gap_s),
        rotation_deg=frame.rotation % 360,
        is_truncated=timeline.is_truncated,
    )


class VideoReader:
    """Random access to the frames of a video by index.

    Opening costs a look at the sample table (MP4, MOV of constant rate) or one pass over the packets (anything else).
    Every call of `frames` opens the file anew, so that calls are independent of each other and nothing needs closing.

    Attributes:
        path: the file.
        width_px, height_px: size of a full frame.
        num_frames: number of frames.
        rate_hz: the frame rate that the container states, 0 if none; `probe` measures it.
    """

    def __init__(self, path: Path | str, threads: int | None = None) -> None:
        """Open a video.

        Args:
            path: the file.
            threads: decoder threads; the default takes the cores this process may use, at most `MAX_DECODER_THREADS`.

        Raises:
            VideoError: the file is missing, no video, or without frames.
        """
        self.path = Path(path)
        self._threads = threads or min(MAX_DECODER_THREADS, len(os.sched_getaffinity(0)))
        self._timeline = read_timeline(self.path, use_header=True)
        self.rate_hz = self._timeline.nominal_hz
        first = _first_frame(self.path, self._timeline)
        self._rotation_deg = first.rotation % 360
        self.width_px, self.height_px = _shown_size(first.width, first.height, self._rotation_deg)
        self.num_frames = len(self._timeline.pts)

    def size_px(self, max_side_px: int | None = None) -> tuple[int, int]:
        """Width and height at which `frames` delivers for a given limit of the longer side.

        A full-size pixel coordinate c becomes (c + 0.5) * s - 0.5 with s = size / full size of its axis, which is what
        `Camera.scaled(*reader.size_px(limit))` does.
        """
        longest = max(self.width_px, self.height_px)
        if max_side_px is None or longest <= max_side_px:
            return self.width_px, self.height_px
        if max_side_px < 1:
            raise ValueError(f"max_side_px is {max_side_px}, must be at least 1")
        scale = max_side_px / longest
        return max(1, round(self.width_px * scale)), max(1, round(self.height_px * scale))

    def frames(
        self,
        first: int,
        count: int,
        step: int = 1,
        max_side_px: int | None = None,
        on_missing: Literal["raise", "skip"] = "raise",
    ) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Decode frames `first`, `first + step`, …: `count` of them, after one seek.

        Args:
            first: index of the first frame.
            count: how many frames to deliver.
            step: distance between them; the frames between are decoded but not converted.
            max_side_px: scale down (area averaging) so that the longer side has at most so many pixels; see `size_px`.
            on_missing: `raise` at a frame that cannot be had, after those before it were delivered; `skip` leaves such
                frames out (damaged data up to the next key frame, the missing end of a truncated file).

        Yields:
            Frame index and its picture, RGB uint8 `(height, width, 3)`.

        Raises:
            VideoError: `undecodable_frame`, `truncated_file`, `frame_out_of_range` or `irregular_timestamps`, with the
                frame's index.
        """
        if first < 0 or count < 0 or step < 1:
            raise ValueError(f"{self.path}: frames(first={first}, count={count}, step={step}) must be >= 0, >= 0, >= 1")
        for index, frame in self._decoded(range(first, first + count * step, step), on_missing == "skip"):
            yield index, self._picture(frame, max_side_px)

    def _decoded(self, wanted: range, may_skip: bool) -> Iterator[tuple[int, Any]]:
        """Frames of the wanted indices, each checked to be the one that its timestamp says."""
        pending = iter(wanted[: max(0, -(-(self.num_frames - wanted.start) // wanted.step))])
        expected = next(pending, None)
        if expected is not None:
            for frame in decoded_from(self.path, int(self._timeline.pts[expected]), self._threads):
                index = self._index(frame.pts, expected)
                while expected is not None and index > expected:
                    if not may_skip:
                        raise _undecodable(self.path, expected, is_at_end=False)
                    expected = next(pending, None)
                if index == expected:
                    yield index, frame
                    expected = next(pending, None)
                if expected is None:
                    break
        if expected is not None and not may_skip:
            raise _undecodable(self.path, expected, is_at_end=True)
        if not may_skip and len(wanted) and wanted[-1] >= self.num_frames:
            raise self._out_of_range(wanted)

    def _index(self, pts: int, expected: int) -> int:
        index = self._timeline.index(pts)
        if index is None:
            text = f"{self.path}: timestamp {pts} near frame {expected} is not on the grid its sample table promises"
            remedy = "remux it (ffmpeg -i IN -c copy OUT.mp4)"
            raise VideoError(f"{text}; {remedy}", "irregular_timestamps", str(self.path), expected)
        return index

    def _out_of_range(self, wanted: range) -> VideoError:
        frame = next(index for index in wanted if index >= self.num_frames)
        text = f"{self.path}: frame {frame} was asked for, the video has {self.num_frames}"
        if self._timeline.is_truncated:
            return VideoError(f"{text} before it breaks off; copy it again", "truncated_file", str(self.path), frame)
        return VideoError(f"{text} (0 to {self.num_frames - 1})", "frame_out_of_range", str(self.path), frame)

    def _picture(self, frame: Any, max_side_px: int | None) -> NDArray[np.uint8]:
        width_px, height_px = _shown_size(*self.size_px(max_side_px), self._rotation_deg)
        # Area averaging is both the fastest and the only alias-free way to reduce; it keeps pixel centres aligned.
        picture: NDArray[np.uint8] = frame.to_ndarray(
            format="rgb24", width=width_px, height=height_px, interpolation=Interpolation.AREA, threads=1
        )
        return np.ascontiguousarray(np.rot90(picture, self._rotation_deg // 90)) if self._rotation_deg else picture


def _first_frame(path: Path, timeline: Timeline) -> Any:
    """The first frame that can be decoded."""
    frame = next(decoded_from(path, int(timeline.pts[0])), None)
    if frame is None:
        raise _undecodable(path, 0, is_at_end=False)
    return frame


def _shown_size(width_px: int, height_px: int, rotation_deg: int) -> tuple[int, int]:
    return (height_px, width_px) if rotation_deg % 180 else (width_px, height_px)


def _mean_gap_s(timeline: Timeline, tick_s: Fraction) -> Fraction:
    pts = timeline.pts
    if len(pts) > 1:
        return Fraction(int(pts[-1] - pts[0]), len(pts) - 1) * tick_s
    return 1 / timeline.nominal_hz if timeline.nominal_hz else Fraction(1)


def _is_constant_rate(pts: NDArray[np.int64]) -> bool:
    """Whether every timestamp is within a tick of an even grid (Matroska rounds to milliseconds)."""
    grid = np.linspace(pts[0], pts[-1], len(pts))
    return bool(np.abs(pts - grid).max() <= 1)


def _undecodable(path: Path, frame: int, is_at_end: bool) -> VideoError:
    if is_at_end and frame:
        text = f"{path}: ends before frame {frame} could be decoded; copy it again, or use frames 0 to {frame - 1}"
        return VideoError(text, "truncated_file", str(path), frame)
    text = f"{path}: frame {frame} cannot be decoded, its data are damaged; copy the file again, or leave the frame out"
    return VideoError(text, "undecodable_frame", str(path), frame)
