"""Tables of how good results are: without truth, against the truth, and over several sequences.

What pixels, ``valid`` and ``reason`` mean: `catalog`.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import FLAG, HAND, HAND_VIEW, SEQUENCE, TEXT, each
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.joints import NUM_JOINTS

QUALITY: Final = TableSpec(
    "quality",
    1,
    ("sequence_id", "table", "row", "metric"),
    pa.schema(
        [*SEQUENCE, ("table", TEXT), ("row", TEXT), ("metric", TEXT), ("value", pa.float64()), ("n", pa.int64())]
    ),
)
ERRORS: Final = TableSpec(
    "errors",
    2,
    ("sequence_id", "frame", "hand", "method"),
    pa.schema(
        [
            *HAND,
            ("method", TEXT),  # 2d_triangulation, R1, ...: a row of the paper's tables
            ("error_mm", each(pa.float32(), NUM_JOINTS)),  # distance to the truth; NaN where the joint is missing
            ("wrist_relative_error_mm", each(pa.float32(), NUM_JOINTS)),  # with both wrists moved to the origin
            ("is_labelled", each(FLAG, NUM_JOINTS)),  # the truth is known
            ("is_own", FLAG),  # the method found these joints itself, instead of keeping those of another
            ("verb", TEXT),  # what is being done; empty between actions
            ("occlusion_rate", pa.float32()),  # of both hands' joints over the exocentric views, NaN if unknown
        ]
    ),
)
EGO_ERRORS: Final = TableSpec(
    "ego_errors",
    2,
    ("sequence_id", "frame", "hand", "camera_id", "labels"),
    pa.schema(
        [
            *HAND_VIEW,
            ("labels", TEXT),  # manual, automatic: held against whose
            ("verb", TEXT),
            ("error_mm", each(pa.float32(), NUM_JOINTS)),  # with both wrists at the origin; NaN where missing
            ("is_labelled", each(FLAG, NUM_JOINTS)),
            ("is_identity_right", FLAG),
            ("border_px", pa.float32()),  # from the hand's joints to the border of the picture
        ]
    ),
)
EVALUATION: Final = TableSpec(
    "evaluation",
    1,
    ("sequence_id", "table", "group", "row", "metric"),
    pa.schema(
        [
            *SEQUENCE,
            ("table", TEXT),  # annotation, annotation_by_finger, ...
            ("group", TEXT),  # which finger, verb, ...; empty in the table over all
            ("row", TEXT),  # the method
            ("metric", TEXT),
            ("value", pa.float64()),
            ("low", pa.float64()),  # 95 % interval; NaN where there are too few instants for one
            ("high", pa.float64()),
            ("n", pa.int64()),  # joints that the value is of
            ("coverage", pa.float64()),  # found among the labelled joints, in percent
        ]
    ),
)
