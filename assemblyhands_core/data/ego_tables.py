"""Tables of the headset's pictures: where it was, crops with labels, and hands found in them.

What pixels, ``valid`` and ``reason`` mean: `catalog`.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import CAMERA, FLAG, HAND_VIEW, INSTANT, OUTCOME, TEXT, each
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.joints import NUM_JOINTS

EGO_FRAMES: Final = TableSpec(
    "ego_frames",
    2,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *INSTANT,
            ("camera_id", TEXT),
            ("T_camera_from_world", each(pa.float64(), 16)),  # 4x4 by rows, mm: the headset moves
            ("image_file", TEXT),  # a picture of its own; empty where the camera's video has it
            ("image_bytes", pa.int64()),  # its size, so that another picture is another row; -1 without any
            ("verb", TEXT),  # what is being done, if known
            *OUTCOME,
        ]
    ),
)
EGO_BOXES: Final = TableSpec(
    "ego_boxes",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            ("box_px", each(pa.float64(), 4)),  # left, top, right, bottom in the rectified picture
            ("is_valid", each(FLAG, NUM_JOINTS)),  # which of the hand's joints count in this picture
        ]
    ),
)
EGO_CROPS: Final = TableSpec(
    "ego_crops",
    2,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            *CAMERA,  # of the crop, a pinhole
            ("image", pa.binary()),
            ("joints_camera_mm", each(pa.float32(), 6 * NUM_JOINTS)),  # right hand first; NaN where not labelled
            ("joints_wrist_relative_mm", each(pa.float32(), 6 * NUM_JOINTS)),  # the same, each hand from its wrist
            ("joints_px", each(pa.float32(), 4 * NUM_JOINTS)),  # in the crop
            ("is_labelled", each(FLAG, 2 * NUM_JOINTS)),  # known, and in the crop
            ("identity", TEXT),  # whose joints the crop shows: left, right, both
            ("num_in_image", pa.int8()),  # joints of this hand
            ("border_px", pa.float32()),  # from this hand's joints to the border of the picture; below 0 they leave it
            ("verb", TEXT),  # what is being done, if known
            ("source", TEXT),  # who annotated
            *OUTCOME,
        ]
    ),
)
EGO_PICTURES: Final = TableSpec(
    "ego_pictures",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *INSTANT,
            ("camera_id", TEXT),
            *CAMERA,  # of the rectified picture, a pinhole
            ("picture_file", TEXT),
            ("sha256", TEXT),
            ("joints_px", each(pa.float32(), 4 * NUM_JOINTS)),  # right hand first; NaN where not labelled
            ("is_labelled", each(FLAG, 2 * NUM_JOINTS)),  # known, and in the picture
            ("box_px", each(pa.float64(), 8)),  # right hand, left hand: left, top, right, bottom; NaN without crop
        ]
    ),
)
EGO_HANDS: Final = TableSpec(
    "ego_hands",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            ("joints_px", each(pa.float32(), 2 * NUM_JOINTS)),  # in the crop
            ("depth_mm", each(pa.float32(), NUM_JOINTS)),  # beyond the wrist, along the optical axis
            ("confidence", each(pa.float32(), NUM_JOINTS)),
            ("joints_camera_mm", each(pa.float32(), 3 * NUM_JOINTS)),
            ("joints_world_mm", each(pa.float32(), 3 * NUM_JOINTS)),
            ("wrist_depth_mm", pa.float32()),  # that the joints were lifted with
            ("wrist_depth_source", TEXT),  # label, hand_size
            ("identity", TEXT),  # the likeliest of left, right, both
            ("identity_probability", each(pa.float32(), 3)),  # right, left, both
            *OUTCOME,
        ]
    ),
)
