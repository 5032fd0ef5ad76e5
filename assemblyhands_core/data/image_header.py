"""How large a JPEG or PNG picture says it is, read before any room is made for its pixels.

A file of a hundred bytes may declare pixels for gigabytes, and one of a megabyte may ask for the same pixels to be gone
through ten thousand times. Sources: ITU T.81 (JPEG), annex B; PNG specification, sections 5.2 and 11.2.2.
"""

import struct
from typing import Final

MAX_SIDE_PX: Final = 2**15
MAX_PIXELS: Final = 2**26
"""Of a picture or a frame of a video: twice those of 8K."""
_MAX_SCANS: Final = 100  # of a progressive JPEG; encoders write about ten
_PNG_START: Final = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
_FILM_CHUNKS: Final = frozenset({b"acTL", b"fcTL", b"fdAT"})
_JPEG_START: Final = b"\xff\xd8\xff"
_START_OF_SCAN: Final = 0xDA
_FRAME_HEADERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH: Final = frozenset({0x01, *range(0xD0, 0xD9)})


def declared_size(data: bytes) -> tuple[int, int]:
    """Return the width and height that the header of a picture declares.

    Raises:
        ValueError: It is neither JPEG nor PNG, its header is cut off, or it is larger than `MAX_PIXELS`.
    """
    if data.startswith(_PNG_START) and len(data) >= len(_PNG_START) + 8:
        width, height = struct.unpack_from(">II", data, len(_PNG_START))
        _check_chunks(data)
    elif data.startswith(_JPEG_START):
        width, height = _jpeg_size(data)
    else:
        raise ValueError("neither JPEG nor PNG")
    if not is_possible(width, height):
        raise ValueError(f"{width}×{height} px, more than a picture may have")
    return width, height


def is_possible(width_px: int, height_px: int) -> bool:
    """Return whether a picture of this size is worth room."""
    return 0 < width_px <= MAX_SIDE_PX and 0 < height_px <= MAX_SIDE_PX and width_px * height_px <= MAX_PIXELS


def _check_chunks(data: bytes) -> None:
    """Refuse what makes OpenCV set room aside for gigabytes: chunks longer than the file, and films."""
    place, kind = 8, b""
    while kind != b"IEND":
        if place + 12 > len(data):
            raise ValueError("a PNG that is cut off")
        length, kind = struct.unpack_from(">I4s", data, place)
        if kind in _FILM_CHUNKS:
            raise ValueError("an animated PNG")
        place += 12 + length
    if place > len(data):
        raise ValueError("a PNG that is cut off")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    place = 2
    # Decoders skip what stands between two segments, and fill bytes of 255 before a marker.
    while 0 <= (place := data.find(b"\xff", place)) < len(data) - 9:
        marker = data[place + 1]
        if marker in (0x00, 0xFF) or marker in _WITHOUT_LENGTH:
            place += 1 if marker == 0xFF else 2
            continue
        if marker == _START_OF_SCAN:
            break
        if marker in _FRAME_HEADERS:
            if data.count(bytes((0xFF, _START_OF_SCAN))) > _MAX_SCANS:
                raise ValueError(f"a JPEG of more than {_MAX_SCANS} scans")
            height, width = struct.unpack_from(">HH", data, place + 5)
            return width, height
        place += 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    raise ValueError("a JPEG without a frame header")
