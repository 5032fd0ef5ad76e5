"""Pictures to bytes and back."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from assemblyhands_core.data.crop_images import (
    IMAGE_SIZE_MISMATCH,
    MISSING_IMAGE,
    UNREADABLE_IMAGE,
    decode_image,
    encode_jpeg,
    read_picture,
)
from assemblyhands_core.data.image_header import MAX_PIXELS, MAX_SIDE_PX, declared_size

RED, BLUE = (200, 30, 40), (20, 60, 220)


def _flag() -> np.ndarray:
    """Red above, blue below."""
    image = np.empty((32, 16, 3), np.uint8)
    image[:16], image[16:] = RED, BLUE
    return image


def test_red_stays_red_and_up_stays_up() -> None:
    image = decode_image(encode_jpeg(_flag(), 95))
    assert image.shape == (32, 16, 3) and image.dtype == np.uint8
    error = np.abs(image.astype(int) - _flag())
    assert max(error[:14].max(), error[18:].max()) < 4  # colour is halved in size, so it blurs at the border


def test_quality_costs_bytes_and_the_same_gives_the_same() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    assert len(encode_jpeg(noise, 30)) < len(encode_jpeg(noise, 90)) / 1.5
    assert encode_jpeg(noise, 90) == encode_jpeg(noise.copy(), 90)


@pytest.mark.parametrize("data", [b"", b"no picture"])
def test_bytes_that_are_no_picture_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=f"{len(data)} bytes are no picture"):
        decode_image(data)


def _png(width: int, height: int) -> bytes:
    """Bytes that declare a grey picture of this size, and have a row or so of it."""
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", zlib.compress(bytes(999))))
    blocks = [
        struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in (*chunks, (b"IEND", b""))
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(blocks)


def _jpeg(width: int, height: int) -> bytes:
    """A small JPEG whose header declares this size instead of its own."""
    data = encode_jpeg(_flag(), 95)
    place = data.index(b"\xff\xc0") + 5
    return data[:place] + struct.pack(">HH", height, width) + data[place + 4 :]


@pytest.mark.parametrize("encode", [_png, _jpeg])
def test_the_declared_size_is_that_of_the_header(encode: Callable[[int, int], bytes]) -> None:
    assert declared_size(encode(1920, 1080)) == (1920, 1080)
    assert declared_size(encode(16, 32)) == (16, 32)


@pytest.mark.parametrize("arguments", [[cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2], []])
def test_every_kind_of_jpeg_says_its_size_and_is_decoded(arguments: list[int]) -> None:
    data = cv2.imencode(".jpg", _flag(), arguments)[1].tobytes()
    assert declared_size(data) == (16, 32)
    assert decode_image(data).shape == (32, 16, 3)


@pytest.mark.parametrize("encode", [_png, _jpeg])
@pytest.mark.parametrize(
    "size_px", [(MAX_SIDE_PX + 1, 1), (1, MAX_SIDE_PX + 1), (MAX_SIDE_PX, MAX_PIXELS // MAX_SIDE_PX + 1), (0, 9)]
)
def test_giant_pictures_are_refused_before_they_are_decoded(
    encode: Callable[[int, int], bytes], size_px: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ValueError, match="more than a picture may have"):
        decode_image(encode(*size_px))


def test_a_jpeg_of_very_many_scans_is_refused() -> None:
    data = cv2.imencode(".jpg", _flag(), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    scan = data[data.rindex(b"\xff\xda") : -2]
    assert decode_image(data[:-2] + 10 * scan + data[-2:]).shape == (32, 16, 3)
    with pytest.raises(ValueError, match="more than 100 scans"):
        decode_image(data[:-2] + 100 * scan + data[-2:])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda png: png[:-1], "a PNG that is cut off"),
        (lambda png: png[:33] + b"\xe0" + png[34:], "a PNG that is cut off"),  # a chunk of 3.7 GB, found by the fuzzer
        (lambda png: png[:33] + b"\0\0\0\x08acTL" + bytes(12) + png[33:], "an animated PNG"),
    ],
)
def test_a_png_whose_chunks_are_not_there_is_not_decoded(
    change: Callable[[bytes], bytes], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    png = cv2.imencode(".png", _flag())[1].tobytes()
    assert decode_image(png).shape == (32, 16, 3)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ValueError, match=reason):
        decode_image(change(png))


@pytest.mark.parametrize("suffix", [".bmp", ".webp", ".tiff", ".ppm"])
def test_only_jpeg_and_png_are_decoded_though_opencv_knows_more(suffix: str) -> None:
    data = cv2.imencode(suffix, _flag())[1].tobytes()
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None
    with pytest.raises(ValueError, match="neither JPEG nor PNG"):
        decode_image(data)


def test_a_pictures_file_gives_pixels_or_a_reason(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    assert read_picture(path, (16, 32)) == MISSING_IMAGE
    path.write_bytes(encode_jpeg(_flag(), 95))
    assert read_picture(path, (32, 16)) == IMAGE_SIZE_MISMATCH
    assert np.asarray(read_picture(path, (16, 32))).shape == (32, 16, 3)
    path.write_bytes(_png(2**30, 2**30))
    assert read_picture(path, (2**30, 2**30)) == UNREADABLE_IMAGE
