"""Tables between the stages of the studio, which make a synthetic recording.

What says something true about the scene stands in `ground_truth`; these hold what is ordered, filmed and delivered.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import FRAME, SEQUENCE, TEXT
from assemblyhands_core.data.tables import TableSpec

TAKES: Final = TableSpec(
    "takes",
    2,
    ("sequence_id",),
    pa.schema([*SEQUENCE, ("rig", TEXT), ("duration_s", pa.float64()), ("rate_hz", pa.int32())]),
)
"""What is to be recorded; the sequence's name says who, with which toy and on which day."""

CROP_ORDERS: Final = TableSpec(
    "crop_orders",
    1,
    ("sequence_id",),
    pa.schema([*SEQUENCE, ("split", TEXT), ("rig", TEXT), ("duration_s", pa.float64())]),
)
"""A set of takes of which crops are to be drawn: its split says of whom, its duration how many."""

ACTIONS: Final = TableSpec(
    "actions",
    1,
    ("sequence_id", "start_s", "verb", "hand"),
    pa.schema(
        [
            *SEQUENCE,
            ("verb", TEXT),
            ("noun", TEXT),
            ("hand", TEXT),
            ("start_s", pa.float64()),
            ("end_s", pa.float64()),
        ]
    ),
)
FOOTAGE: Final = TableSpec(
    "footage",
    1,
    ("sequence_id", "camera_id", "first_frame"),
    pa.schema(
        [
            *SEQUENCE,
            ("camera_id", TEXT),
            ("first_frame", FRAME),
            ("num_frames", pa.int32()),
            ("video_file", TEXT),
            ("sha256", TEXT),
        ]
    ),
)
DELIVERED: Final = TableSpec(
    "delivered",
    1,
    ("sequence_id", "path"),
    pa.schema([*SEQUENCE, ("path", TEXT), ("content_file", TEXT), ("sha256", TEXT)]),
)
"""The files of a recording: where each belongs below the data set's folder, and its content."""
