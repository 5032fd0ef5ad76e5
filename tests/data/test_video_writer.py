"""The writer's files: same pictures, same bytes; true colours; errors that name the file."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.video import VideoError, VideoReader, VideoWriter, probe

WIDTH_PX, HEIGHT_PX = 128, 48


def drifting_picture(index: int) -> np.ndarray:
    ramp = (np.arange(WIDTH_PX) * 2 + index * 12) % 256
    return np.broadcast_to(ramp[None, :, None], (HEIGHT_PX, WIDTH_PX, 3)).astype(np.uint8)


def test_written_bytes_depend_on_the_pictures_only(tmp_path: Path) -> None:
    for name in ("one", "two"):
        with VideoWriter(tmp_path / name, WIDTH_PX, HEIGHT_PX, Fraction(60000, 1001)) as writer:
            for index in range(20):
                writer.write(drifting_picture(index))
        assert writer.num_frames == 20
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    info = probe(tmp_path / "one")
    assert (info.num_frames, info.rate_hz, info.codec) == (20, Fraction(60000, 1001), "h264")
    for index, picture in VideoReader(tmp_path / "one").frames(0, 20):
        errors = [np.abs(picture.astype(int) - drifting_picture(other)).mean() for other in range(20)]
        assert np.argmin(errors) == index


def test_colours_survive_writing_and_reading(tmp_path: Path) -> None:
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255], [0, 0, 0], [90, 160, 30]], np.uint8)
    picture = np.repeat(np.repeat(colours[None], 32, axis=1), 64, axis=0)
    with VideoWriter(tmp_path / "colours.mp4", 192, 64, 25, crf=1) as writer:
        writer.write(picture)
    (_, read), *_ = VideoReader(tmp_path / "colours.mp4").frames(0, 1)
    patches = read.reshape(64, 6, 32, 3)[16:48, :, 8:24].astype(int).mean(axis=(0, 2))
    np.testing.assert_allclose(patches, colours, atol=4)


def test_odd_sides_are_padded_by_repetition(tmp_path: Path) -> None:
    picture = np.full((33, 65, 3), 40, np.uint8)
    picture[:, -1], picture[-1] = 220, 220
    with VideoWriter(tmp_path / "odd.mp4", 65, 33, 30, crf=1) as writer:
        writer.write(picture)
    (_, read), *_ = VideoReader(tmp_path / "odd.mp4").frames(0, 1)
    assert read.shape == (34, 66, 3)
    np.testing.assert_allclose(read[:33, :65].astype(int), picture, atol=12)
    np.testing.assert_allclose(read[33, :, 0], 220, atol=12)


def test_the_writer_refuses_wrong_pictures_and_places(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", 64, 32, 30) as writer:
        writer.write(np.zeros((32, 64, 3), np.uint8))
        with pytest.raises(ValueError, match=r"picture is uint8 \(64, 32, 3\), must be uint8 \(32, 64, 3\)"):
            writer.write(np.zeros((64, 32, 3), np.uint8))
    assert probe(tmp_path / "a.mp4").num_frames == 1
    with pytest.raises(VideoError, match="cannot be written") as caught:
        VideoWriter(tmp_path / "absent" / "a.mp4", 64, 32, 30)
    assert caught.value.reason == "unwritable_file"
    with pytest.raises(ValueError, match="0 x 32"):
        VideoWriter(tmp_path / "b.mp4", 0, 32, 30)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux' always full device")
def test_a_full_disk_is_an_error_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "full.mp4").symlink_to("/dev/full")
    with pytest.raises(VideoError) as caught, VideoWriter(tmp_path / "full.mp4", WIDTH_PX, HEIGHT_PX, 30) as writer:
        for index in range(60):
            writer.write(drifting_picture(index))
    assert caught.value.reason == "unwritable_file"
