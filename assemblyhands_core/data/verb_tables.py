"""Tables of verb classification: clips of poses, what was left out, and what a network says."""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.tables import TableSpec

_TEXT, _FLAGS = pa.string(), pa.list_(pa.bool_())
_SEGMENT: Final = [("sequence_id", _TEXT), ("segment", pa.int32())]

VERB_CLIPS: Final = TableSpec(
    "verb_clips",
    1,
    ("sequence_id", "segment"),
    pa.schema(
        [
            *_SEGMENT,
            ("verb", _TEXT),
            ("noun", _TEXT),
            ("first_key", pa.int64()),  # 60 Hz frames of the segment, without the context that the clip has
            ("last_key", pa.int64()),
            ("rate_hz", pa.int32()),  # of the clip's instants
            ("graph", _TEXT),  # what its nodes are
            ("nodes_mm", pa.list_(pa.float32())),  # instant × hand × node × xyz, NaN for a hand that is never seen
            ("observed", _FLAGS),  # instant × hand: measured there
            ("is_interpolated", _FLAGS),  # put between instants at which it was
        ]
    ),
)
VERB_PROBLEMS: Final = TableSpec(
    "verb_problems",
    1,
    ("sequence_id", "reason", "sentence"),
    pa.schema([("sequence_id", _TEXT), ("reason", _TEXT), ("count", pa.int64()), ("sentence", _TEXT)]),
)
"""Why segments were left out (by reason, with a count and no sentence), and each odd one (with its sentence)."""

VERB_PREDICTIONS: Final = TableSpec(
    "verb_predictions",
    1,
    ("sequence_id", "segment"),
    pa.schema(
        [
            *_SEGMENT,
            ("verb", _TEXT),
            ("predicted", _TEXT),  # empty where no pose was seen
            ("confidence", pa.float32()),
            ("probability", pa.list_(pa.float32())),  # of each class, in the order of the network
            ("first_key", pa.int64()),
            ("pose_error_mm", pa.float32()),  # mean of its nodes, wrists at the origin; NaN where nobody knows
            ("coverage", pa.float32()),  # instants and hands of its clip that were observed, in percent
        ]
    ),
)
