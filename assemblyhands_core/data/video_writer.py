"""Deterministic writing of video."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from assemblyhands_core.data.video_stream import VideoError


class VideoWriter:
    """Write H.264 in MP4, byte for byte the same for the same pictures; use it as a context manager.

    The file is not written atomically: give it a temporary name and rename.

    Attributes:
        path: the file.
        width_px, height_px: size of the pictures given; an odd side is stored with its last column or row repeated,
            as 4:2:0 colour needs even sides.
        num_frames: pictures written so far.
    """

    def __init__(
        self, path: Path | str, width_px: int, height_px: int, rate_hz: Fraction | float, crf: int = 18
    ) -> None:
        """Create the file.

        Args:
            path: the file, replaced if it exists.
            width_px, height_px: size of the pictures.
            rate_hz: frame rate.
            crf: x264's constant rate factor, 0 (lossless) to 51; 18 is visually close to lossless.

        Raises:
            VideoError: `unwritable_file`.
        """
        self.path, self.width_px, self.height_px, self.num_frames = Path(path), width_px, height_px, 0
        rate = Fraction(rate_hz).limit_denominator(1001)
        if width_px < 1 or height_px < 1 or rate <= 0:
            raise ValueError(f"{path}: a video of {width_px} x {height_px} px at {rate_hz} Hz cannot be written")
        self._container = av.open(str(self.path), "w", format="mp4", options={"movflags": "+faststart"})
        # One thread: x264's output depends on how many there are. No creation time is stored unless asked for.
        # Macroblock-tree rate control gave other bytes for equal pictures in 3 of 40 encodings (x264's SIMD code).
        options = {"crf": str(crf), "preset": "veryfast", "threads": "1", "x264-params": "mbtree=0"}
        self._stream: Any = self._container.add_stream("libx264", rate=rate, options=options)
        self._stream.width, self._stream.height = width_px + width_px % 2, height_px + height_px % 2
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.colorspace = Colorspace.ITU601  # what the conversion from RGB uses, so say it
        self._stream.codec_context.color_range = ColorRange.MPEG
        try:
            self._container.start_encoding()
        except (av.error.FFmpegError, OSError) as error:
            raise self._unwritable(error) from error

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Append one picture, RGB uint8 `(height, width, 3)`.

        Raises:
            VideoError: `unwritable_file`, for example a full disk.
        """
        if picture.shape != (self.height_px, self.width_px, 3) or picture.dtype != np.uint8:
            expected = (self.height_px, self.width_px, 3)
            raise ValueError(f"{self.path}: picture is {picture.dtype} {picture.shape}, must be uint8 {expected}")
        padding = ((0, self.height_px % 2), (0, self.width_px % 2), (0, 0))
        padded = np.pad(picture, padding, mode="edge") if self.height_px % 2 or self.width_px % 2 else picture
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(padded), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU601, threads=1)
        frame.pts, frame.time_base = self.num_frames, 1 / self._stream.codec_context.framerate
        self._mux(frame)
        self.num_frames += 1

    def close(self) -> None:
        """Write what is pending and close the file."""
        try:
            self._mux(None)
        finally:
            self._close_container()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if error is None:
            self.close()
        else:
            self._close_container()

    def _mux(self, frame: Any) -> None:
        try:
            self._container.mux(self._stream.encode(frame))
        except (av.error.FFmpegError, OSError) as error:
            raise self._unwritable(error) from error

    def _close_container(self) -> None:
        try:
            self._container.close()
        except (av.error.FFmpegError, OSError) as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: Exception) -> VideoError:
        cause = str(getattr(error, "strerror", error)).lower()
        text = f"{self.path}: cannot be written ({cause}); check the folder, its permissions and the free space"
        return VideoError(text, "unwritable_file", str(self.path))
