"""Pictures to bytes and back."""

import numpy as np
import pytest

from assemblyhands_core.data.crop_images import decode_image, encode_jpeg

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
