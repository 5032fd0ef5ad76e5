"""Joining videos end to end without encoding them anew."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av

from assemblyhands_core.data.video_stream import VideoError


def concatenate(parts: Sequence[Path], path: Path) -> None:
    """Join videos that `VideoWriter` has written with the same settings; the same parts give the same bytes.

    Args:
        parts: In order; each begins with a key frame.
        path: MP4 file to write.

    Raises:
        ValueError: There is no part, or they differ in size or rate.
        VideoError: `not_a_video`, a part cannot be read.
    """
    if not parts:
        raise ValueError(f"{path}: there is nothing to join")
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as target:
        stream: Any = None
        start = 0
        for part in parts:
            with _opened(part) as source:
                template = source.streams.video[0]
                if stream is None:
                    stream, kind = target.add_stream_from_template(template), _kind(template)
                if _kind(template) != kind:
                    raise ValueError(f"{part} differs in size or rate from {parts[0]}: make them with equal settings")
                for packet in source.demux(template):
                    if packet.dts is None:  # the flush at the end
                        continue
                    packet.stream, packet.pts, packet.dts = stream, packet.pts + start, packet.dts + start
                    target.mux(packet)
                start += template.duration


def _opened(part: Path) -> Any:
    try:
        return av.open(str(part))
    except (av.error.FFmpegError, OSError) as error:
        text = f"{part}: cannot be read ({str(error).lower()}); make it anew"
        raise VideoError(text, "not_a_video", str(part)) from error


def _kind(stream: Any) -> tuple[Any, ...]:
    return stream.width, stream.height, stream.time_base, stream.average_rate, stream.codec_context.extradata
