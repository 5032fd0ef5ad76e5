"""Tables that networks are trained with, and what comes of it.

What pixels, ``valid`` and ``reason`` mean: `catalog`.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import FLAG, HAND, INSTANT, SEQUENCE, TEXT, each
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS

HAND_LABELS: Final = TableSpec(
    "hand_labels",
    1,
    ("sequence_id", "frame", "hand"),
    pa.schema(
        [
            *HAND,
            ("joints_world_mm", each(pa.float32(), 3 * NUM_JOINTS)),
            ("valid", each(FLAG, NUM_JOINTS)),
            ("source", TEXT),  # truth, or who annotated
            ("verb", TEXT),  # what is being done, if known
            ("occlusion_rate", pa.float32()),  # of the joints in all views, NaN if unknown
        ]
    ),
)
BODY_LABELS: Final = TableSpec(
    "body_labels",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *INSTANT,
            ("camera_id", TEXT),
            ("image", pa.binary()),  # the whole picture, reduced
            ("body_px", each(pa.float32(), 2 * NUM_BODY_KEYPOINTS)),  # in that picture
            ("valid", each(FLAG, NUM_BODY_KEYPOINTS)),
        ]
    ),
)
WEIGHTS: Final = TableSpec(
    "weights",
    1,
    ("sequence_id", "network"),
    pa.schema(
        [*SEQUENCE, ("network", TEXT), ("weights_file", TEXT), ("sha256", TEXT), ("card", TEXT)]  # card: JSON
    ),
)
TRAINING_CURVE: Final = TableSpec(
    "training_curve",
    1,
    ("sequence_id", "step"),
    pa.schema([*SEQUENCE, ("step", pa.int64()), ("loss", pa.float64()), ("error", pa.float64())]),
)
