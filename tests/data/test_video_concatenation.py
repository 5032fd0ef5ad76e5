"""Parts joined end to end give back every picture of every part, from any place."""

from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.video import VideoReader, probe
from assemblyhands_core.data.video_concatenation import concatenate
from assemblyhands_core.data.video_stream import VideoError
from assemblyhands_core.data.video_writer import VideoWriter

LENGTHS = (15, 15, 4)


def write(path: Path, first: int, count: int, width: int = 96) -> Path:
    ramp = np.linspace(0, 255, width, dtype=np.uint8)
    with VideoWriter(path, width, 64, 30) as video:
        for frame in range(first, first + count):
            video.write(np.ascontiguousarray(np.broadcast_to(np.roll(ramp, 7 * frame)[None, :, None], (64, width, 3))))
    return path


@pytest.fixture
def parts(tmp_path: Path) -> list[Path]:
    return [write(tmp_path / f"{n}.mp4", 15 * n, count) for n, count in enumerate(LENGTHS)]


def test_every_picture_is_that_of_its_part(parts: list[Path], tmp_path: Path) -> None:
    concatenate(parts, tmp_path / "whole.mp4")
    info = probe(tmp_path / "whole.mp4")
    assert info.num_frames == sum(LENGTHS) and info.rate_hz == 30 and info.is_constant_rate
    single = [image for part, n in zip(parts, LENGTHS, strict=True) for _, image in VideoReader(part).frames(0, n)]
    whole = list(VideoReader(tmp_path / "whole.mp4").frames(0, sum(LENGTHS)))
    assert [frame for frame, _ in whole] == list(range(sum(LENGTHS)))
    assert all(np.array_equal(a, b) for a, (_, b) in zip(single, whole, strict=True))
    for frame in (14, 15, 16, 33):
        ((_, image),) = VideoReader(tmp_path / "whole.mp4").frames(frame, 1)
        assert np.array_equal(image, single[frame])


def test_the_same_parts_give_the_same_bytes(parts: list[Path], tmp_path: Path) -> None:
    for name in ("one.mp4", "two.mp4"):
        concatenate(parts, tmp_path / name)
    assert (tmp_path / "one.mp4").read_bytes() == (tmp_path / "two.mp4").read_bytes()


def test_what_cannot_be_joined_is_refused(parts: list[Path], tmp_path: Path) -> None:
    other = write(tmp_path / "other.mp4", 0, 3, width=80)
    with pytest.raises(ValueError, match=r"other\.mp4 differs in size or rate from .*0\.mp4"):
        concatenate([parts[0], other], tmp_path / "whole.mp4")
    with pytest.raises(ValueError, match="nothing to join"):
        concatenate([], tmp_path / "whole.mp4")
    (tmp_path / "junk.mp4").write_bytes(b"junk")
    with pytest.raises(VideoError, match=r"junk\.mp4: cannot be read"):
        concatenate([tmp_path / "junk.mp4"], tmp_path / "whole.mp4")
