"""Exactness of seeking, determinism of decoding, and what videos say of themselves."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from numbered_videos import GOPS, HEIGHT_PX, NUM_FRAMES, WIDTH_PX, number_in, numbers, same, write_numbered

from assemblyhands_core.data.video import VideoError, VideoReader, VideoWriter, probe


@pytest.mark.parametrize("gop", GOPS)
def test_every_frame_is_found_by_a_seek_to_it(clip: Any, gop: str) -> None:
    reader = VideoReader(clip(gop), threads=1)
    assert reader.num_frames == NUM_FRAMES
    found = [pair for index in range(NUM_FRAMES) for pair in numbers(reader, index, 1)]
    assert found == same(*range(NUM_FRAMES))


def test_the_open_gop_clip_is_one(clip: Any) -> None:
    """Pictures that are shown before a key frame are stored after it, or the test above would prove nothing."""
    with av.open(str(clip("open_gop"))) as container:
        packets = [(p.pts, p.is_keyframe) for p in container.demux(video=0) if p.size]
    assert sum(is_key and packets[i + 1][0] < pts for i, (pts, is_key) in enumerate(packets[:-1])) == 5


@pytest.mark.parametrize("suffix", ["mkv", "mov", "ts", "avi"])
def test_containers_without_a_usable_sample_table_are_as_exact(clip: Any, suffix: str, tmp_path: Path) -> None:
    gop = "no_b_frames" if suffix == "avi" else "open_gop"  # AVI stores no presentation timestamps
    reader = VideoReader(clip(gop, suffix), threads=1)
    assert reader.num_frames == NUM_FRAMES
    found = [pair for index in range(0, NUM_FRAMES, 7) for pair in numbers(reader, index, 3) if index < NUM_FRAMES - 3]
    assert found == same(*(i + k for i in range(0, NUM_FRAMES - 3, 7) for k in range(3)))


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("gop", ["b_frames", "open_gop"])
def test_chunks_join_without_gap_or_overlap(clip: Any, gop: str, threads: int) -> None:
    reader = VideoReader(clip(gop), threads=threads)
    chunks = [numbers(reader, first, min(16, NUM_FRAMES - first)) for first in range(0, NUM_FRAMES, 16)]
    assert [pair for chunk in chunks for pair in chunk] == same(*range(NUM_FRAMES))


def test_steps_skip_frames(clip: Any) -> None:
    assert numbers(VideoReader(clip("b_frames")), 5, 4, step=7) == same(5, 12, 19, 26)


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
def test_a_start_time_does_not_shift_the_index(tmp_path: Path, suffix: str) -> None:
    path = write_numbered(tmp_path / f"late.{suffix}", GOPS["b_frames"], pts=range(45, 45 + NUM_FRAMES))
    reader = VideoReader(path, threads=1)
    assert numbers(reader, 0, 2) + numbers(reader, 40, 2) + numbers(reader, 69, 1) == same(0, 1, 40, 41, 69)
    info = probe(path)
    assert info.num_frames == NUM_FRAMES
    assert info.start_s == pytest.approx(1.5, abs=1e-3)


def test_variable_rate_counts_frames_not_seconds(tmp_path: Path) -> None:
    stamps = np.cumsum(np.random.default_rng(0).integers(1, 5, NUM_FRAMES)).tolist()
    path = write_numbered(tmp_path / "variable.mp4", GOPS["b_frames"], pts=stamps)
    reader, info = VideoReader(path), probe(path)
    assert (reader.num_frames, info.num_frames, info.is_constant_rate) == (NUM_FRAMES, NUM_FRAMES, False)
    assert numbers(reader, 0, NUM_FRAMES) == same(*range(NUM_FRAMES))
    assert [numbers(reader, index, 1)[0] for index in (3, 33, 68)] == same(3, 33, 68)


def test_an_edit_list_that_starts_inside_a_gop_hides_the_frames_before_it(clip: Any, tmp_path: Path) -> None:
    """MPEG-4 files cut without re-encoding hold frames that players decode but never show."""
    path = tmp_path / "cut.mp4"
    with av.open(str(clip("one_gop"))) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                shift = round(20 / 30 / packet.time_base)  # frame 20 becomes time 0, those before it negative
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, stream
                target.mux(packet)
    reader, info = VideoReader(path), probe(path)
    assert reader.num_frames == info.num_frames
    first_shown = number_in(next(reader.frames(0, 1))[1])
    assert reader.num_frames == NUM_FRAMES - first_shown
    assert numbers(reader, 10, 3) == [(i, i + first_shown) for i in (10, 11, 12)]


@pytest.mark.parametrize("quarter_turns", [1, 2, 3])
def test_pictures_are_turned_as_players_show_them(clip: Any, tmp_path: Path, quarter_turns: int) -> None:
    """Phones store upright video lying on its side, with a matrix in the track header that says so."""
    data = bytearray(clip("b_frames").read_bytes())
    matrix_at = data.index(b"tkhd") + 44
    a, b = ((0, 1), (-1, 0), (0, -1))[quarter_turns - 1]  # x' = a x - b y, y' = b x + a y: clockwise on the screen
    matrix = np.array([[a, b, 0], [-b, a, 0], [0, 0, 1 << 14]]) * 65536
    data[matrix_at : matrix_at + 36] = matrix.astype(">i4").tobytes()
    path = tmp_path / "turned.mp4"
    path.write_bytes(data)
    reader, info = VideoReader(path), probe(path)
    shape = (HEIGHT_PX, WIDTH_PX) if quarter_turns == 2 else (WIDTH_PX, HEIGHT_PX)
    assert (info.height_px, info.width_px) == (reader.height_px, reader.width_px) == shape
    (_, upright), *_ = VideoReader(clip("b_frames")).frames(33, 1)
    (_, turned), *_ = reader.frames(33, 1)
    np.testing.assert_array_equal(turned, np.rot90(upright, -quarter_turns))
    capture = cv2.VideoCapture(str(path))
    ok, bgr = capture.read()
    assert ok and bgr.shape == turned.shape  # calibration tools that read through OpenCV see the same orientation
    (_, small), *_ = reader.frames(33, 1, max_side_px=64)
    assert small.shape[:2] == reader.size_px(64)[::-1] == (shape[0] // 2, shape[1] // 2)


def test_probe_measures(clip: Any) -> None:
    info = probe(clip("b_frames"))
    assert (info.width_px, info.height_px, info.num_frames, info.num_frames_header) == (WIDTH_PX, HEIGHT_PX, 70, 70)
    assert (info.rate_hz, info.codec, info.pixel_format) == (Fraction(30), "h264", "yuv420p")
    assert (info.is_constant_rate, info.is_truncated, info.rotation_deg) == (True, False, 0)
    assert info.duration_s == pytest.approx(70 / 30) and info.start_s == 0.0


@pytest.mark.parametrize("suffix", ["mkv", "ts"])
def test_probe_needs_no_header_count(clip: Any, suffix: str) -> None:
    info = probe(clip("open_gop", suffix))
    assert (info.num_frames, info.num_frames_header, info.is_constant_rate) == (NUM_FRAMES, 0, True)
    assert (info.rate_hz, info.is_truncated) == (Fraction(30), False)


def test_asking_beyond_the_end_names_the_frame_after_delivering_what_there_is(clip: Any) -> None:
    reader, got = VideoReader(clip("b_frames")), []
    with pytest.raises(VideoError, match=r"frame 70 was asked for, the video has 70") as caught:
        got.extend(index for index, _ in reader.frames(67, 8))
    assert got == [67, 68, 69]
    assert (caught.value.reason, caught.value.frame) == ("frame_out_of_range", 70)
    assert list(reader.frames(67, 0)) == []


@pytest.mark.parametrize("arguments", [(-1, 1, 1), (0, -1, 1), (0, 1, 0)])
def test_impossible_requests_are_refused(clip: Any, arguments: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="must be >= 0, >= 0, >= 1"):
        list(VideoReader(clip("b_frames")).frames(*arguments))


def test_reduced_pictures_keep_pixel_centres(tmp_path: Path) -> None:
    """A blob's centre (c) must land on (c + 0.5) s - 0.5 along both axes, also where sides do not divide."""
    height_px, width_px, centre = 362, 644, np.array([401.0, 123.0])
    y, x = np.mgrid[:height_px, :width_px]
    blob = 200 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * 24.0**2))
    with VideoWriter(tmp_path / "blob.mp4", width_px, height_px, 30, crf=0) as writer:
        writer.write(np.repeat(blob[..., None], 3, axis=2).round().astype(np.uint8))
    reader = VideoReader(tmp_path / "blob.mp4")
    for max_side_px in (None, 643, 320, 256, 101):
        (_, picture), *_ = reader.frames(0, 1, max_side_px=max_side_px)
        width, height = reader.size_px(max_side_px)
        assert picture.shape == (height, width, 3)
        weight = np.clip(picture.mean(axis=2) - 20, 0, None)
        v, u = np.mgrid[:height, :width]
        measured = np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()
        expected = (centre + 0.5) * [width / width_px, height / height_px] - 0.5
        np.testing.assert_allclose(measured, expected, atol=0.03)


def test_reduced_sizes_keep_the_aspect_and_never_enlarge(clip: Any) -> None:
    reader = VideoReader(clip("b_frames"))
    assert [reader.size_px(side) for side in (None, 128, 999, 64, 3)] == [
        (128, 48),
        (128, 48),
        (128, 48),
        (64, 24),
        (3, 1),
    ]
    with pytest.raises(ValueError, match="max_side_px is 0"):
        reader.size_px(0)
    assert numbers(reader, 33, 2, max_side_px=64) == same(33, 34)


def test_decoding_is_deterministic_and_independent_of_threads(clip: Any) -> None:
    pictures = [
        [picture.tobytes() for _, picture in VideoReader(clip("open_gop"), threads=threads).frames(3, 30)]
        for threads in (1, 1, 3)
    ]
    assert pictures[0] == pictures[1] == pictures[2]
