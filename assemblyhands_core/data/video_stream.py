"""Packets, timestamps and seeking: what `video` needs to know about a stream to be frame-exact.

Sources: FFmpeg's API documentation (AVPacket, av_seek_frame); all claims are measured in `tests/data/test_video.py`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal

import av
import numpy as np
from numpy.typing import NDArray

from assemblyhands_core.data.image_header import MAX_PIXELS, is_possible

VideoReason = Literal[
    "missing_file",
    "not_a_video",
    "no_frames",
    "irregular_timestamps",
    "undecodable_frame",
    "truncated_file",
    "frame_out_of_range",
    "unwritable_file",
]
_CONTAINERS = (
    "mov,matroska,avi,mpegts,mpeg,mpegvideo,mxf,flv,asf,ogg,nut,dv,gxf,ivf,obu,yuv4mpegpipe,"
    "h264,hevc,vvc,m4v,mjpeg,mjpeg_2000,vc1,gif,apng"
)
"""Formats that hold their pictures themselves. Playlists (HLS, ffconcat) have us read whatever files they name."""
_MAX_REORDERING = 32  # packets; H.264 and HEVC reorder over at most 16 frames
_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": _CONTAINERS, "max_pixels": str(MAX_PIXELS)}


class VideoError(ValueError):
    """A video, or one of its frames, cannot be read or written.

    Attributes:
        reason: one of `VideoReason`, for counting.
        path: the video file.
        frame: index of the first frame concerned, None where the whole file is.
    """

    def __init__(self, message: str, reason: VideoReason, path: str, frame: int | None = None) -> None:
        super().__init__(message, reason, path, frame)  # all arguments, so that the error survives pickling
        self.reason, self.path, self.frame = reason, path, frame

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True, eq=False)
class Timeline:
    """Presentation timestamps of the frames of a stream.

    Attributes:
        pts: int64 `(N,)`, ascending, in ticks of the stream's time base.
        is_truncated: whether packets are missing or cut off at the end of the file.
        nominal_hz: the frame rate that the container states; 0 where it says nothing.
    """

    pts: NDArray[np.int64]
    is_truncated: bool
    nominal_hz: Fraction

    def index(self, pts: int | None) -> int | None:
        """Frame index of a timestamp; None where the stream has no such frame."""
        if pts is None:
            return None
        index = int(np.searchsorted(self.pts, pts))
        return index if index < len(self.pts) and self.pts[index] == pts else None


@contextmanager
def opened(path: Path, threads: int = 1) -> Iterator[tuple[Any, Any]]:
    """Open a file for reading: its container and its main video stream.

    Raises:
        VideoError: `missing_file` or `not_a_video`.
    """
    if not path.is_file():
        known_as = path.resolve() if path.is_symlink() else path  # the store has links to the videos of a rig
        raise VideoError(
            f"{known_as}: no such file; check the path or the pattern of rig.videos", "missing_file", str(path)
        )
    try:
        container = av.open(str(path.resolve()), options=_OPTIONS)
    except av.error.EOFError as error:
        raise _no_frames(path) from error
    except av.error.ArgumentError as error:  # what FFmpeg says of formats that were not allowed
        raise _not_a_video(path, "no video stream in a format that holds its own pictures") from error
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise _not_a_video(path, str(getattr(error, "strerror", error)).lower()) from error
    with container:
        stream = container.streams.best("video")
        if stream is None or stream.codec_context is None:
            raise _not_a_video(path, "no video stream that this FFmpeg can decode")
        width, height = stream.codec_context.width, stream.codec_context.height
        if width and height and not is_possible(width, height):
            raise _not_a_video(path, f"its pictures of {width}×{height} px are larger than any camera's")
        stream.codec_context.options = {"max_pixels": _OPTIONS["max_pixels"]}  # of pictures that grow on the way
        stream.codec_context.thread_count = threads
        stream.codec_context.thread_type = "AUTO" if threads > 1 else "NONE"
        yield container, stream


def _not_a_video(path: Path, cause: str) -> VideoError:
    text = f"{path}: cannot be opened as video ({cause}); copy it again or re-encode it, or leave this view out"
    return VideoError(text, "not_a_video", str(path))


def _no_frames(path: Path) -> VideoError:
    return VideoError(f"{path}: holds no video frame; record or copy it again", "no_frames", str(path))


def read_timeline(path: Path, use_header: bool) -> Timeline:
    """Timestamps of all frames, from the container's sample table where that settles them, else from every packet.

    Args:
        path: The video.
        use_header: Accept a complete sample table of constant rate (MP4, MOV) instead of reading the whole file.

    Raises:
        VideoError: `missing_file`, `not_a_video`, `no_frames`, or `irregular_timestamps` where the container has none.
    """
    timeline = _timeline_of_sample_table(path) if use_header else None
    timeline = timeline or _timeline_of_packets(path)
    if len(timeline.pts) == 0:
        raise _no_frames(path)
    return timeline


def _timeline_of_sample_table(path: Path) -> Timeline | None:
    with opened(path) as (container, stream):
        entries = list(stream.index_entries)
        if len(entries) < 2 or len(entries) != stream.frames or any(entry.is_discard for entry in entries):
            return None
        head = [packet.pts for packet in islice(_packets(container, stream), _MAX_REORDERING)]
        nominal_hz = _nominal_hz(stream)
    gaps = np.diff([entry.timestamp for entry in entries])
    is_complete = entries[-1].pos + entries[-1].size <= path.stat().st_size
    # The table is in decoding order; at constant rate presentation is the same row of ticks, begun at the key frame.
    if not is_complete or not head or None in head or head[0] != min(head) or not 0 < gaps.min() == gaps.max():
        return None
    pts = head[0] + np.arange(len(entries), dtype=np.int64) * int(gaps[0])
    return Timeline(pts, is_truncated=False, nominal_hz=nominal_hz)


def _timeline_of_packets(path: Path) -> Timeline:
    with opened(path) as (container, stream):
        packets = list(_packets(container, stream))
        first_key = next((packet.pts for packet in packets if packet.is_keyframe), None)
        if any(packet.pts is None for packet in packets):
            text = f"{path}: has packets without timestamps; remux it (ffmpeg -i IN -c copy OUT.mp4)"
            raise VideoError(text, "irregular_timestamps", str(path))
        if first_key is None:
            return Timeline(np.empty(0, dtype=np.int64), is_truncated=True, nominal_hz=Fraction(0))
        whole = [packet for packet in packets if not packet.is_corrupt]
        is_short = len(whole) < max(len(packets), stream.frames) or _ends_early(container, stream, packets)
        nominal_hz = _nominal_hz(stream)
    # Pictures shown before the first key frame refer to one that was cut away: no decoder can make them.
    shown = [packet.pts for packet in whole if not packet.is_discard and packet.pts >= first_key]
    pts = np.unique(np.array(shown, dtype=np.int64))
    last_dts = packets[-1].dts
    if last_dts is not None and (is_short or _has_hole_after(pts, last_dts)):
        # What is missing would be decoded, hence shown, after the last packet. Frames known to be shown later still
        # have holes between them where their B-frames were cut off, so their rank is unknown: leave them out.
        return Timeline(pts[pts <= last_dts], is_truncated=True, nominal_hz=nominal_hz)
    return Timeline(pts, is_short, nominal_hz)


def _nominal_hz(stream: Any) -> Fraction:
    return Fraction(stream.average_rate or stream.guessed_rate or 0)


def _ends_early(container: Any, stream: Any, packets: list[Any]) -> bool:
    """Whether the packets stop more than three frames before the duration that the header promises."""
    duration = stream.duration
    if duration is None and container.duration and len(container.streams) == 1:
        duration = round(container.duration / av.time_base / stream.time_base)
    first, last = min(packet.pts for packet in packets), max(packet.pts for packet in packets)
    gap = (last - first) / max(1, len(packets) - 1)
    # Some containers count the duration from their first frame, some from time 0: believe the one that says "whole".
    return duration is not None and max(last, last - first) + 4 * gap < duration


def _has_hole_after(pts: NDArray[np.int64], last_dts: int) -> bool:
    """Whether frames lie clearly farther apart after the last decoding time than anywhere before it."""
    num_settled = int(np.searchsorted(pts, last_dts, side="right"))
    gaps = np.diff(pts)
    settled, open_end = gaps[: max(0, num_settled - 1)], gaps[max(0, num_settled - 1) :]
    return len(settled) > 0 and len(open_end) > 0 and bool(open_end.max() > 1.5 * settled.max())


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """Packets of the stream in decoding order; ends quietly where the file breaks off."""
    try:
        yield from (packet for packet in container.demux(stream) if packet.size)
    except (av.error.FFmpegError, IndexError):  # PyAV trips with the latter over streams that damage makes appear
        return


def decoded_from(path: Path, pts: int, threads: int = 1) -> Iterator[Any]:
    """Decode from the key frame at or before a timestamp, in presentation order.

    Frames that depend on a lost packet are left out up to the next key frame, as the decoder would only guess them.

    Yields:
        `av.VideoFrame`s with timestamps from `pts` on.
    """
    start = pts
    for is_last_try in (False, True):
        with opened(path, threads) as (container, stream):
            packets = _packets_from_key(container, stream, start)
            key = next(packets, None)
            frames = _from(pts, _decoded(stream, chain([key] if key else [], packets)))
            first = next(frames, None)
            if first is not None and (first.pts == pts or is_last_try):
                yield first
                yield from frames
                return
        if key is None:
            break
        # With periodic intra refresh a "key frame" only begins a recovery: the one before it then gives the picture.
        start = key.pts - 1
    with opened(path, threads) as (container, stream):  # the container has a broken index, or none
        yield from _from(pts, _decoded(stream, _packets(container, stream)))


def _from(pts: int, frames: Iterator[Any]) -> Iterator[Any]:
    return (frame for frame in frames if frame.pts >= pts)


def _packets_from_key(container: Any, stream: Any, pts: int) -> Iterator[Any]:
    """Packets from the last key frame shown at or before `pts`; none where the container cannot seek.

    Demuxers may seek by decoding time: they then stop at a key frame shown *after* `pts` (open GOP), from which the
    wanted frame would decode to garbage. So the key frame's own timestamp is checked; if need be we go further back.
    """
    step = max(1, round(1 / stream.time_base))
    origin = stream.start_time or 0
    target = pts
    while True:
        try:
            container.seek(target, stream=stream, backward=True)
        except av.error.FFmpegError:
            return iter(())
        packets = _packets(container, stream)
        key = next((packet for packet in packets if packet.is_keyframe), None)
        if key is not None and (key.pts <= pts or target < origin):
            return chain([key], packets)
        if target < origin:
            return iter(())
        target, step = target - step, 2 * step


def _decoded(stream: Any, packets: Iterator[Any]) -> Iterator[Any]:
    decoder = stream.codec_context
    in_flight: deque[int | None] = deque(maxlen=max(1, decoder.thread_count))  # a threaded decoder reports errors late
    distrusted: set[int | None] = set()
    is_broken = False
    for packet in packets:
        is_broken = packet.is_corrupt or (is_broken and not packet.is_keyframe)
        in_flight.append(packet.pts)
        try:
            frames = [] if packet.is_corrupt else decoder.decode(packet)
        except av.error.FFmpegError:
            is_broken, frames = True, []
            distrusted.update(in_flight)
        if is_broken:
            distrusted.add(packet.pts)
        yield from (frame for frame in frames if _is_sound(frame, distrusted))
    yield from (frame for frame in _flushed(decoder) if _is_sound(frame, distrusted))


def _is_sound(frame: Any, distrusted: set[int | None]) -> bool:
    return frame.pts is not None and frame.pts not in distrusted and not frame.is_corrupt


def _flushed(decoder: Any) -> list[Any]:
    try:
        return list(decoder.decode(None))
    except av.error.FFmpegError:
        return []
