"""Pictures inside table rows: RGB to JPEG bytes and back; and those in files of their own."""

from pathlib import Path
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
import pyarrow as pa
from jaxtyping import UInt8

from assemblyhands_core.data.image_header import declared_size
from assemblyhands_core.data.json_files import read_bytes

ImageRGB = UInt8[np.ndarray, "height width 3"]
ImageBytes: TypeAlias = bytes | pa.Buffer
"""An encoded picture, of its own or still inside a table."""

MISSING_IMAGE: Final = "missing_image"
UNREADABLE_IMAGE: Final = "unreadable_image"
IMAGE_SIZE_MISMATCH: Final = "image_size_mismatch"
_MAX_PICTURE_BYTES: Final = 2**28


def encode_jpeg(image_rgb: ImageRGB, quality: int) -> bytes:
    """Return an RGB picture as JPEG bytes; the same picture and quality give the same bytes."""
    bgr = cv2.cvtColor(image_rgb, cv2.COLOR_RGB2BGR)
    is_done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not is_done:
        raise ValueError(f"a picture of shape {image_rgb.shape} cannot be stored as JPEG of quality {quality}")
    return bytes(data)


def decode_image(data: ImageBytes) -> ImageRGB:
    """Return the RGB picture of JPEG or PNG bytes; of any other format nothing is read.

    Raises:
        ValueError: the bytes are no picture, or declare a larger one than `image_header` lets pass.
    """
    try:
        declared_size(bytes(data))
        image: Any = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR_RGB)
    except (ValueError, cv2.error) as error:
        raise ValueError(f"{len(data)} bytes are no picture ({error}); skip rows that are not valid") from error
    if image is None:
        raise ValueError(f"{len(data)} bytes are no picture; skip rows that are not valid")
    return np.asarray(image, dtype=np.uint8)


def read_picture(path: Path, size_px: tuple[int, int]) -> ImageRGB | str:
    """Return the RGB picture of a file, or the reason why it is of no use.

    Args:
        path: JPEG or PNG; a grey picture becomes grey three times.
        size_px: Width and height that it has to have.
    """
    if not path.is_file():
        return MISSING_IMAGE
    try:
        picture = decode_image(read_bytes(path, _MAX_PICTURE_BYTES))
    except ValueError:
        return UNREADABLE_IMAGE
    return picture if picture.shape[1::-1] == size_px else IMAGE_SIZE_MISMATCH
