"""Exactness of seeking, honesty about damage, determinism of writing. Each picture carries its own index as bars."""

import contextlib
import pickle
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from assemblyhands_core.data.video import VideoError, VideoReader, VideoWriter, probe

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


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """A numbered clip by GOP structure and container, encoded once."""
    folder, made = tmp_path_factory.mktemp("clips"), {}

    def get(gop: str, suffix: str = "mp4") -> Path:
        if (gop, suffix) not in made:
            made[gop, suffix] = write_numbered(folder / f"{gop}.{suffix}", GOPS[gop])
        return made[gop, suffix]

    return get


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


@pytest.fixture
def truncated(tmp_path: Path) -> Path:
    """The index of the file (moov) is at its head and whole; a third of the pictures is cut off."""
    path = write_numbered(tmp_path / "truncated.mp4", GOPS["b_frames"], container_options=FASTSTART)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    return path


def test_a_truncated_file_gives_its_whole_frames_and_then_says_where_it_ends(truncated: Path) -> None:
    info, reader, got = probe(truncated), VideoReader(truncated), []
    assert info.is_truncated and 20 < info.num_frames < 70 == info.num_frames_header
    with pytest.raises(VideoError) as caught:
        got.extend(numbers(reader, 0, 20))
        for index, picture in reader.frames(20, 50):
            got.append((index, number_in(picture)))
    assert got == same(*range(len(got))) and info.num_frames - 4 <= len(got) <= info.num_frames
    assert (caught.value.reason, caught.value.frame) == ("truncated_file", len(got))
    assert str(truncated) in str(caught.value) and f"frame {len(got)}" in str(caught.value)
    assert numbers(reader, 20, 50, on_missing="skip") == same(*range(20, len(got)))


@pytest.mark.parametrize(
    ("gop", "suffix"), [("open_gop", "ts"), ("pyramid", "mkv"), ("b_frames", "flv"), ("b_frames", "mp4")]
)
def test_wherever_a_file_is_cut_the_frames_keep_their_numbers(tmp_path: Path, gop: str, suffix: str) -> None:
    """The last packets before a cut show pictures later than some that are lost: their rank would be too low."""
    whole = write_numbered(
        tmp_path / f"whole.{suffix}", GOPS[gop], container_options=FASTSTART if suffix == "mp4" else {}
    )
    data, path = whole.read_bytes(), tmp_path / f"cut.{suffix}"
    num_frames = []
    for cut in np.random.default_rng(0).integers(len(data) // 2, len(data) * 99 // 100, 12):
        path.write_bytes(data[:cut])
        reader = VideoReader(path, threads=1)
        found = numbers(reader, max(0, reader.num_frames - 8), 8, on_missing="skip")
        assert found == same(*(index for index, _ in found))
        num_frames.append(reader.num_frames)
    assert max(num_frames) > 50


@pytest.mark.parametrize("seed", range(6))
def test_damage_of_any_kind_ends_in_frames_or_our_own_error(clip: Any, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for gop, suffix in (("b_frames", "mp4"), ("open_gop", "mkv"), ("open_gop", "ts"), ("no_b_frames", "avi")):
        data = np.frombuffer(clip(gop, suffix).read_bytes(), np.uint8).copy()
        data[rng.integers(0, len(data), 10)] = rng.integers(0, 256, 10)
        start = rng.integers(len(data))
        data[start : start + 1000] = 0
        path = tmp_path / f"damaged.{suffix}"
        path.write_bytes(data.tobytes())
        for read in (probe, lambda path: numbers(VideoReader(path, threads=1), 10, 40)):
            with contextlib.suppress(VideoError):
                read(path)


def test_a_truncated_matroska_file_is_told_from_a_whole_one(clip: Any, tmp_path: Path) -> None:
    data = clip("open_gop", "mkv").read_bytes()
    path = tmp_path / "truncated.mkv"
    path.write_bytes(data[: len(data) * 2 // 3])
    assert probe(path).is_truncated
    assert numbers(VideoReader(path), 5, 3) == same(5, 6, 7)


def test_damaged_data_are_reported_and_left_out_up_to_the_next_key_frame(clip: Any, tmp_path: Path) -> None:
    with av.open(str(clip("b_frames"))) as container:
        packets = [(p.pos, p.size, p.is_keyframe) for p in container.demux(video=0) if p.size]
    position, size, is_key = packets[24]
    assert is_key
    data = bytearray(clip("b_frames").read_bytes())
    data[position : position + size] = b"\xff" * size
    path = tmp_path / "damaged.mp4"
    path.write_bytes(data)
    for threads in (1, 4):
        reader = VideoReader(path, threads=threads)
        found = numbers(reader, 0, NUM_FRAMES, on_missing="skip")
        assert [pair for pair in found if pair[0] != pair[1]] == []
        assert {*range(12), *range(36, 70)} <= {index for index, _ in found}
        assert 24 not in {index for index, _ in found}
        with pytest.raises(VideoError, match="damaged") as caught:
            numbers(reader, 20, 20)
        assert caught.value.reason == "undecodable_frame"


@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "not_a_video"), (b"no video at all " * 99, "not_a_video"), (bytes(5000), "not_a_video")],
)
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "cam01.mp4"
    path.write_bytes(content)
    for read in (probe, VideoReader):
        with pytest.raises(VideoError, match=r"cam01\.mp4: cannot be opened as video") as caught:
            read(path)
        assert caught.value.reason == reason


def test_a_file_cut_before_its_index_is_refused(clip: Any, tmp_path: Path) -> None:
    data = clip("b_frames").read_bytes()
    path = tmp_path / "headless.mp4"
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(VideoError) as caught:
        probe(path)
    assert caught.value.reason == "not_a_video"


@pytest.mark.parametrize(("suffix", "reason"), [("mkv", "no_frames"), ("mp4", "not_a_video")])
def test_a_video_that_never_got_a_frame_is_refused(tmp_path: Path, suffix: str, reason: str) -> None:
    path = tmp_path / f"empty.{suffix}"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        container.start_encoding()
    with pytest.raises(VideoError) as caught:
        probe(path)
    assert caught.value.reason == reason


def test_a_video_cut_before_its_first_frame_has_none(tmp_path: Path) -> None:
    path = write_numbered(tmp_path / "cut.mp4", GOPS["b_frames"], container_options=FASTSTART)
    with av.open(str(path)) as container:
        first_byte = next(container.demux(video=0)).pos
    path.write_bytes(path.read_bytes()[:first_byte])
    for read in (probe, VideoReader):
        with pytest.raises(VideoError, match="holds no video frame") as caught:
            read(path)
        assert caught.value.reason == "no_frames"


def test_sound_is_no_video(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
    with pytest.raises(VideoError, match="no video stream") as caught:
        VideoReader(path)
    assert caught.value.reason == "not_a_video"


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    for path in (tmp_path / "absent.mp4", tmp_path):
        with pytest.raises(VideoError, match=str(path)) as caught:
            VideoReader(path)
        assert caught.value.reason == "missing_file"


def test_a_playlist_cannot_make_us_open_other_files(clip: Any, tmp_path: Path) -> None:
    path = tmp_path / "list.mp4"
    path.write_text(f"ffconcat version 1.0\nfile '{clip('b_frames')}'\n")
    with pytest.raises(VideoError):
        probe(path)


def test_the_error_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(VideoError("a: b; c", "no_frames", "a", 7)))
    assert (str(error), error.reason, error.path, error.frame) == ("a: b; c", "no_frames", "a", 7)


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
