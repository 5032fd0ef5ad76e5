"""Honesty about damage, and what is no video."""

import contextlib
import pickle
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numbered_videos import FASTSTART, GOPS, HEIGHT_PX, NUM_FRAMES, WIDTH_PX, number_in, numbers, same, write_numbered

from assemblyhands_core.data import image_header, video
from assemblyhands_core.data.video import VideoError, VideoReader, probe


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


@pytest.mark.parametrize("name", ["list.mp4", "list.m3u8"])
@pytest.mark.parametrize("is_absolute", [True, False])
def test_a_playlist_cannot_make_us_open_other_files(clip: Any, tmp_path: Path, name: str, is_absolute: bool) -> None:
    copy = tmp_path / "secret" / "other.ts"
    copy.parent.mkdir()
    with av.open(str(clip("b_frames"))) as source, av.open(str(copy), "w") as sink:
        stream = sink.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                sink.mux(packet)
    assert probe(copy).num_frames > 1
    other, path = copy if is_absolute else "secret/other.ts", tmp_path / name
    hls = f"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1.0,\n{other}\n#EXT-X-ENDLIST\n"
    path.write_text(f"ffconcat version 1.0\nfile {other}\n" if path.suffix == ".mp4" else hls)
    with pytest.raises(VideoError) as caught:
        probe(path)
    assert caught.value.reason == "not_a_video"


def test_pictures_larger_than_any_cameras_are_refused_before_one_is_decoded(
    clip: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = clip("b_frames")
    monkeypatch.setattr(image_header, "MAX_PIXELS", WIDTH_PX * HEIGHT_PX)
    assert VideoReader(path).num_frames == NUM_FRAMES
    monkeypatch.setattr(image_header, "MAX_PIXELS", WIDTH_PX * HEIGHT_PX - 1)
    monkeypatch.setattr(video, "_first_frame", lambda *_: pytest.fail("decoded"))
    for read in (VideoReader, probe):
        with pytest.raises(VideoError, match=f"pictures of {WIDTH_PX}×{HEIGHT_PX} px are larger than any camera's"):
            read(path)


def test_the_error_survives_pickling() -> None:
    error = pickle.loads(pickle.dumps(VideoError("a: b; c", "no_frames", "a", 7)))
    assert (str(error), error.reason, error.path, error.frame) == ("a: b; c", "no_frames", "a", 7)
