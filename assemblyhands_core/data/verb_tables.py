"""Tables of verb classification: clips of poses, what was left out, and what a network says."""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import FLAG, SEQUENCE, TEXT, each
from assemblyhands_core.data.fine_grained import VERBS
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH

_FLAGS: Final = each(FLAG, len(HANDS))
_SEGMENT: Final = [*SEQUENCE, ("segment", pa.int32())]

VERB_CLIPS: Final = TableSpec(
    "verb_clips",
    2,
    ("sequence_id", "segment", "instant"),
    pa.schema(
        [
            *_SEGMENT,
            ("instant", pa.int32()),  # from 0; a clip has one at least
            ("verb", TEXT),
            ("noun", TEXT),
            ("first_key", pa.int64()),  # 60 Hz frames of the segment, without the context that the clip has
            ("last_key", pa.int64()),
            ("rate_hz", pa.int32()),  # of the clip's instants
            ("graph", TEXT),  # what its nodes are
            ("nodes_mm", each(pa.float32(), NUM_BOTH * 3)),  # hand × node × xyz, NaN for a hand that is never seen
            ("observed", _FLAGS),  # of each hand: measured there
            ("is_interpolated", _FLAGS),  # put between instants at which it was
        ]
    ),
)
VERB_PROBLEMS: Final = TableSpec(
    "verb_problems",
    1,
    ("sequence_id", "reason", "sentence"),
    pa.schema([*SEQUENCE, ("reason", TEXT), ("count", pa.int64()), ("sentence", TEXT)]),
)
"""Why segments were left out (by reason, with a count and no sentence), and each odd one (with its sentence)."""

VERB_PREDICTIONS: Final = TableSpec(
    "verb_predictions",
    2,
    ("sequence_id", "segment"),
    pa.schema(
        [
            *_SEGMENT,
            ("verb", TEXT),
            ("predicted", TEXT),  # empty where no pose was seen
            ("confidence", pa.float32()),
            ("probability", each(pa.float32(), len(VERBS))),  # of Assembly101's verbs; 0 of what is no class
            ("first_key", pa.int64()),
            ("pose_error_mm", pa.float32()),  # mean of its nodes, wrists at the origin; NaN where nobody knows
            ("coverage", pa.float32()),  # instants and hands of its clip that were observed, in percent
        ]
    ),
)
