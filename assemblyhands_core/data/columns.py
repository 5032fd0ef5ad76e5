"""Columns that several tables share, as lists of names and types."""

from typing import Final

import pyarrow as pa


def each(kind: pa.DataType, count: int) -> pa.DataType:
    """Return the type of a column with so many values in each row."""
    return pa.list_(kind, count)


TEXT, FLAG, FRAME = pa.string(), pa.bool_(), pa.int64()
SEQUENCE: Final = [("sequence_id", TEXT)]
VIEW: Final = [*SEQUENCE, ("camera_id", TEXT)]
INSTANT: Final = [*SEQUENCE, ("frame", FRAME)]
HAND: Final = [*INSTANT, ("hand", TEXT)]
HAND_VIEW: Final = [*HAND, ("camera_id", TEXT)]
OUTCOME: Final = [("valid", FLAG), ("reason", TEXT)]
CAMERA: Final = [
    ("width_px", pa.int32()),
    ("height_px", pa.int32()),
    ("lens_model", TEXT),
    ("intrinsics_px", each(pa.float64(), 4)),  # fx, fy, cx, cy
    ("lens_coefficients", each(pa.float64(), 10)),  # k1..k6, p1..p4
    ("T_camera_from_world", each(pa.float64(), 16)),  # 4x4 by rows, mm
]


def outcome_of_each(count: int) -> list[tuple[str, pa.DataType]]:
    """Return the columns that say how each of so many points came out."""
    return [
        ("valid", each(FLAG, count)),
        ("reason", each(TEXT, count)),
        ("num_views", each(pa.int8(), count)),
        ("reprojection_px", each(pa.float32(), count)),  # mean over the inlier views
    ]
