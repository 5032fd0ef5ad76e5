"""Tables of recordings and their annotation: what a notebook finds in a run's folders.

Those of other subjects: `ego_tables`, `verb_tables`, `evaluation_tables`, `training_tables`, `studio_tables`.

Pixels are of the camera's own video unless the name says otherwise (``_rectified_px``: the undistorted view). ``valid``
and ``reason`` stand beside every measurement: a row is never left out, a hole is NaN with the reason why; the empty
reason means success.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.columns import (
    CAMERA,
    FLAG,
    FRAME,
    HAND,
    HAND_VIEW,
    INSTANT,
    OUTCOME,
    SEQUENCE,
    TEXT,
    VIEW,
    each,
    outcome_of_each,
)
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS

SOURCES: Final = TableSpec(
    "sources",
    1,
    ("sequence_id", "role", "name"),
    pa.schema([*SEQUENCE, ("role", TEXT), ("name", TEXT), ("source_file", TEXT), ("sha256", TEXT)]),
)
MEMBERS: Final = TableSpec(
    "members",
    1,
    ("sequence_id",),
    pa.schema([*SEQUENCE, ("split", TEXT)]),  # train, val, test, ... as the manifest says; empty where it does not
)
VIEWS: Final = TableSpec(
    "views",
    1,
    ("sequence_id", "camera_id"),
    pa.schema(
        [
            *VIEW,
            ("video_file", TEXT),
            ("video_sha256", TEXT),
            ("num_frames", pa.int64()),
            ("rate_hz", pa.float64()),
            ("image_fit", TEXT),  # how the video's pixels follow from the calibrated image's
            ("note", TEXT),  # what a user should know about this view, in a sentence
            *CAMERA,
            *OUTCOME,
        ]
    ),
)
CHUNKS: Final = TableSpec(
    "chunks",
    1,
    ("sequence_id", "chunk"),
    pa.schema([*SEQUENCE, ("chunk", pa.int32()), ("first_frame", FRAME), ("num_frames", pa.int32())]),
)
RECTIFIED_VIEWS: Final = TableSpec(
    "rectified_views",
    1,
    ("sequence_id", "camera_id"),
    pa.schema(
        [
            *VIEW,
            *CAMERA,
            ("kept_fraction", pa.float64()),  # of the video's field of view
            ("valid_region_px", each(pa.float64(), 4)),  # left, top, right, bottom of what shows the video
            ("round_trip_residual_px", pa.float64()),
            ("grid_residual_px", pa.float64()),
            ("grid_step_px", pa.int32()),
            ("grid", pa.binary()),  # RemapGrid.to_bytes(): source pixel of every step-th rectified pixel
            ("rectified_file", TEXT),
            ("rectified_sha256", TEXT),
            *OUTCOME,
        ]
    ),
)
BODY_KEYPOINTS: Final = TableSpec(
    "body_keypoints",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *INSTANT,
            ("camera_id", TEXT),
            ("body_px", each(pa.float32(), 2 * NUM_BODY_KEYPOINTS)),
            ("confidence", each(pa.float32(), NUM_BODY_KEYPOINTS)),
            ("num_persons", pa.int8()),
            *OUTCOME,
        ]
    ),
)
BODIES: Final = TableSpec(
    "bodies",
    1,
    ("sequence_id", "frame"),
    pa.schema(
        [
            *INSTANT,
            ("body_world_mm", each(pa.float32(), 3 * NUM_BODY_KEYPOINTS)),
            *outcome_of_each(NUM_BODY_KEYPOINTS),
        ]
    ),
)
FOLLOWED: Final = TableSpec(
    "followed",
    1,
    ("sequence_id", "first_frame"),
    pa.schema([*SEQUENCE, ("first_frame", FRAME), ("num_persons", pa.int32()), ("note", TEXT)]),
)
HAND_BOXES: Final = TableSpec(
    "hand_boxes",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            ("hand_center_world_mm", each(pa.float32(), 3)),
            ("center_rectified_px", each(pa.float32(), 2)),
            ("side_px", pa.float32()),
            ("source", TEXT),  # detected, interpolated
            *OUTCOME,
        ]
    ),
)
CROPS: Final = TableSpec(
    "crops",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema([*HAND_VIEW, *CAMERA, ("image", pa.binary()), *OUTCOME]),
)
KEYPOINTS: Final = TableSpec(
    "keypoints",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            ("keypoints_px", each(pa.float32(), 2 * NUM_JOINTS)),
            ("confidence", each(pa.float32(), NUM_JOINTS)),
            ("source", TEXT),  # which detector saw it; manual: a person set some of it
            *OUTCOME,
        ]
    ),
)
CORRECTIONS: Final = TableSpec(
    "corrections",
    1,
    ("sequence_id", "frame", "hand", "camera_id", "joint"),
    pa.schema(
        [
            *HAND_VIEW,
            ("joint", TEXT),
            ("corrected_px", each(pa.float64(), 2)),  # NaN where it is not to be used
            ("visibility", pa.int8()),  # 2 seen, 1 hidden, 0 not to be used
            ("weight", pa.float32()),  # in triangulation, where detectors' confidence is at most 1
        ]
    ),
)
JOINTS: Final = TableSpec(
    "joints",
    1,
    ("sequence_id", "frame", "hand", "round"),
    pa.schema(
        [
            *HAND,
            ("joints_world_mm", each(pa.float32(), 3 * NUM_JOINTS)),
            *outcome_of_each(NUM_JOINTS),
            ("source", TEXT),
            ("round", pa.int8()),
        ]
    ),
)
ROUNDS: Final = TableSpec(
    "rounds",
    1,
    ("sequence_id", "frame", "hand", "round"),
    pa.schema(
        [
            *HAND,
            ("round", pa.int8()),
            ("box_source", TEXT),  # what the windows are around: joints of the round before, detected
            ("num_views", pa.int8()),  # whose windows the network was, or would be, shown
            ("is_crop_outside", FLAG),  # a window leaves its stored crop
            ("confidence", pa.float32()),  # mean over the joints of the new estimate, NaN where none was made
            ("displacement_mm", pa.float32()),  # mean over its joints from the round before, 0 where none was needed
            ("kept_round", pa.int8()),  # whose joints this round gives: its own, or an earlier one's
            ("reason", TEXT),  # why they are not its own, or why there are none
            ("note", TEXT),  # the same with figures
        ]
    ),
)
RESIDUALS: Final = TableSpec(
    "residuals",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *HAND_VIEW,
            ("residual_px", each(pa.float32(), NUM_JOINTS)),
            ("is_inlier", each(FLAG, NUM_JOINTS)),
        ]
    ),
)
OVERLAYS: Final = TableSpec(
    "overlays",
    1,
    ("sequence_id", "kind", "camera_id"),
    pa.schema([*SEQUENCE, ("kind", TEXT), ("camera_id", TEXT), ("overlay_file", TEXT), ("sha256", TEXT)]),
)
AUDIT: Final = TableSpec(
    "audit",
    1,
    ("sequence_id", "check", "camera_id"),
    pa.schema(
        [*SEQUENCE, ("check", TEXT), ("camera_id", TEXT), ("level", TEXT), ("value", pa.float64()), ("note", TEXT)]
    ),
)
