"""Every table of the pipeline: what a notebook finds in a run's folders.

Pixels are of the camera's own video unless the name says otherwise (``_rectified_px``: the undistorted view). ``valid``
and ``reason`` stand beside every measurement: a row is never left out, a hole is NaN with the reason why; the empty
reason means success.
"""

from typing import Final

import pyarrow as pa

from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS


def _each(kind: pa.DataType, count: int) -> pa.DataType:
    return pa.list_(kind, count)


_TEXT, _FLAG, _FRAME = pa.string(), pa.bool_(), pa.int64()
_SEQUENCE = [("sequence_id", _TEXT)]
_VIEW = [*_SEQUENCE, ("camera_id", _TEXT)]
_INSTANT = [*_SEQUENCE, ("frame", _FRAME)]
_HAND = [*_INSTANT, ("hand", _TEXT)]
_HAND_VIEW = [*_HAND, ("camera_id", _TEXT)]
_OUTCOME = [("valid", _FLAG), ("reason", _TEXT)]
_CAMERA = [
    ("width_px", pa.int32()),
    ("height_px", pa.int32()),
    ("lens_model", _TEXT),
    ("intrinsics_px", _each(pa.float64(), 4)),  # fx, fy, cx, cy
    ("lens_coefficients", _each(pa.float64(), 10)),  # k1..k6, p1..p4
    ("T_camera_from_world", _each(pa.float64(), 16)),  # 4x4 by rows, mm
]


def _outcome_of_each(count: int) -> list[tuple[str, pa.DataType]]:
    return [
        ("valid", _each(_FLAG, count)),
        ("reason", _each(_TEXT, count)),
        ("num_views", _each(pa.int8(), count)),
        ("reprojection_px", _each(pa.float32(), count)),  # mean over the inlier views
    ]


SOURCES: Final = TableSpec(
    "sources",
    1,
    ("sequence_id", "role", "name"),
    pa.schema([*_SEQUENCE, ("role", _TEXT), ("name", _TEXT), ("source_file", _TEXT), ("sha256", _TEXT)]),
)
MEMBERS: Final = TableSpec(
    "members",
    1,
    ("sequence_id",),
    pa.schema([*_SEQUENCE, ("split", _TEXT)]),  # train, val, test, ... as the manifest says; empty where it does not
)
VIEWS: Final = TableSpec(
    "views",
    1,
    ("sequence_id", "camera_id"),
    pa.schema(
        [
            *_VIEW,
            ("video_file", _TEXT),
            ("video_sha256", _TEXT),
            ("num_frames", pa.int64()),
            ("rate_hz", pa.float64()),
            ("image_fit", _TEXT),  # how the video's pixels follow from the calibrated image's
            ("note", _TEXT),  # what a user should know about this view, in a sentence
            *_CAMERA,
            *_OUTCOME,
        ]
    ),
)
CHUNKS: Final = TableSpec(
    "chunks",
    1,
    ("sequence_id", "chunk"),
    pa.schema([*_SEQUENCE, ("chunk", pa.int32()), ("first_frame", _FRAME), ("num_frames", pa.int32())]),
)
RECTIFIED_VIEWS: Final = TableSpec(
    "rectified_views",
    1,
    ("sequence_id", "camera_id"),
    pa.schema(
        [
            *_VIEW,
            *_CAMERA,
            ("kept_fraction", pa.float64()),  # of the video's field of view
            ("valid_region_px", _each(pa.float64(), 4)),  # left, top, right, bottom of what shows the video
            ("round_trip_residual_px", pa.float64()),
            ("grid_residual_px", pa.float64()),
            ("grid_step_px", pa.int32()),
            ("grid", pa.binary()),  # RemapGrid.to_bytes(): source pixel of every step-th rectified pixel
            ("rectified_file", _TEXT),
            ("rectified_sha256", _TEXT),
            *_OUTCOME,
        ]
    ),
)
BODY_KEYPOINTS: Final = TableSpec(
    "body_keypoints",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *_INSTANT,
            ("camera_id", _TEXT),
            ("body_px", _each(pa.float32(), 2 * NUM_BODY_KEYPOINTS)),
            ("confidence", _each(pa.float32(), NUM_BODY_KEYPOINTS)),
            ("num_persons", pa.int8()),
            *_OUTCOME,
        ]
    ),
)
BODIES: Final = TableSpec(
    "bodies",
    1,
    ("sequence_id", "frame"),
    pa.schema(
        [
            *_INSTANT,
            ("body_world_mm", _each(pa.float32(), 3 * NUM_BODY_KEYPOINTS)),
            *_outcome_of_each(NUM_BODY_KEYPOINTS),
        ]
    ),
)
FOLLOWED: Final = TableSpec(
    "followed",
    1,
    ("sequence_id", "first_frame"),
    pa.schema([*_SEQUENCE, ("first_frame", _FRAME), ("num_persons", pa.int32()), ("note", _TEXT)]),
)
HAND_BOXES: Final = TableSpec(
    "hand_boxes",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("hand_center_world_mm", _each(pa.float32(), 3)),
            ("center_rectified_px", _each(pa.float32(), 2)),
            ("side_px", pa.float32()),
            ("source", _TEXT),  # detected, interpolated
            *_OUTCOME,
        ]
    ),
)
CROPS: Final = TableSpec(
    "crops",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema([*_HAND_VIEW, *_CAMERA, ("image", pa.binary()), *_OUTCOME]),
)
KEYPOINTS: Final = TableSpec(
    "keypoints",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("keypoints_px", _each(pa.float32(), 2 * NUM_JOINTS)),
            ("confidence", _each(pa.float32(), NUM_JOINTS)),
            ("source", _TEXT),  # which detector saw it; manual: a person set some of it
            *_OUTCOME,
        ]
    ),
)
CORRECTIONS: Final = TableSpec(
    "corrections",
    1,
    ("sequence_id", "frame", "hand", "camera_id", "joint"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("joint", _TEXT),
            ("corrected_px", _each(pa.float64(), 2)),  # NaN where it is not to be used
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
            *_HAND,
            ("joints_world_mm", _each(pa.float32(), 3 * NUM_JOINTS)),
            *_outcome_of_each(NUM_JOINTS),
            ("source", _TEXT),
            ("round", pa.int8()),
        ]
    ),
)
HAND_LABELS: Final = TableSpec(
    "hand_labels",
    1,
    ("sequence_id", "frame", "hand"),
    pa.schema(
        [
            *_HAND,
            ("joints_world_mm", _each(pa.float32(), 3 * NUM_JOINTS)),
            ("valid", _each(_FLAG, NUM_JOINTS)),
            ("source", _TEXT),  # truth, or who annotated
            ("verb", _TEXT),  # what is being done, if known
            ("occlusion_rate", pa.float32()),  # of the joints in all views, NaN if unknown
        ]
    ),
)
EGO_FRAMES: Final = TableSpec(
    "ego_frames",
    2,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *_INSTANT,
            ("camera_id", _TEXT),
            ("T_camera_from_world", _each(pa.float64(), 16)),  # 4x4 by rows, mm: the headset moves
            ("image_file", _TEXT),  # a picture of its own; empty where the camera's video has it
            ("image_bytes", pa.int64()),  # its size, so that another picture is another row; -1 without any
            ("verb", _TEXT),  # what is being done, if known
            *_OUTCOME,
        ]
    ),
)
EGO_BOXES: Final = TableSpec(
    "ego_boxes",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("box_px", _each(pa.float64(), 4)),  # left, top, right, bottom in the rectified picture
            ("is_valid", _each(_FLAG, NUM_JOINTS)),  # which of the hand's joints count in this picture
        ]
    ),
)
EGO_CROPS: Final = TableSpec(
    "ego_crops",
    2,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            *_CAMERA,  # of the crop, a pinhole
            ("image", pa.binary()),
            ("joints_camera_mm", _each(pa.float32(), 6 * NUM_JOINTS)),  # right hand first; NaN where not labelled
            ("joints_wrist_relative_mm", _each(pa.float32(), 6 * NUM_JOINTS)),  # the same, each hand from its wrist
            ("joints_px", _each(pa.float32(), 4 * NUM_JOINTS)),  # in the crop
            ("is_labelled", _each(_FLAG, 2 * NUM_JOINTS)),  # known, and in the crop
            ("identity", _TEXT),  # whose joints the crop shows: left, right, both
            ("num_in_image", pa.int8()),  # joints of this hand
            ("border_px", pa.float32()),  # from this hand's joints to the border of the picture; below 0 they leave it
            ("verb", _TEXT),  # what is being done, if known
            ("source", _TEXT),  # who annotated
            *_OUTCOME,
        ]
    ),
)
EGO_PICTURES: Final = TableSpec(
    "ego_pictures",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *_INSTANT,
            ("camera_id", _TEXT),
            *_CAMERA,  # of the rectified picture, a pinhole
            ("picture_file", _TEXT),
            ("sha256", _TEXT),
            ("joints_px", _each(pa.float32(), 4 * NUM_JOINTS)),  # right hand first; NaN where not labelled
            ("is_labelled", _each(_FLAG, 2 * NUM_JOINTS)),  # known, and in the picture
            ("box_px", _each(pa.float64(), 8)),  # right hand, left hand: left, top, right, bottom; NaN without crop
        ]
    ),
)
EGO_HANDS: Final = TableSpec(
    "ego_hands",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("joints_px", _each(pa.float32(), 2 * NUM_JOINTS)),  # in the crop
            ("depth_mm", _each(pa.float32(), NUM_JOINTS)),  # beyond the wrist, along the optical axis
            ("confidence", _each(pa.float32(), NUM_JOINTS)),
            ("joints_camera_mm", _each(pa.float32(), 3 * NUM_JOINTS)),
            ("joints_world_mm", _each(pa.float32(), 3 * NUM_JOINTS)),
            ("wrist_depth_mm", pa.float32()),  # that the joints were lifted with
            ("wrist_depth_source", _TEXT),  # label, hand_size
            ("identity", _TEXT),  # the likeliest of left, right, both
            ("identity_probability", _each(pa.float32(), 3)),  # right, left, both
            *_OUTCOME,
        ]
    ),
)
ROUNDS: Final = TableSpec(
    "rounds",
    1,
    ("sequence_id", "frame", "hand", "round"),
    pa.schema(
        [
            *_HAND,
            ("round", pa.int8()),
            ("box_source", _TEXT),  # what the windows are around: joints of the round before, detected
            ("num_views", pa.int8()),  # whose windows the network was, or would be, shown
            ("is_crop_outside", _FLAG),  # a window leaves its stored crop
            ("confidence", pa.float32()),  # mean over the joints of the new estimate, NaN where none was made
            ("displacement_mm", pa.float32()),  # mean over its joints from the round before, 0 where none was needed
            ("kept_round", pa.int8()),  # whose joints this round gives: its own, or an earlier one's
            ("reason", _TEXT),  # why they are not its own, or why there are none
            ("note", _TEXT),  # the same with figures
        ]
    ),
)
RESIDUALS: Final = TableSpec(
    "residuals",
    1,
    ("sequence_id", "frame", "hand", "camera_id"),
    pa.schema(
        [
            *_HAND_VIEW,
            ("residual_px", _each(pa.float32(), NUM_JOINTS)),
            ("is_inlier", _each(_FLAG, NUM_JOINTS)),
        ]
    ),
)
BODY_LABELS: Final = TableSpec(
    "body_labels",
    1,
    ("sequence_id", "frame", "camera_id"),
    pa.schema(
        [
            *_INSTANT,
            ("camera_id", _TEXT),
            ("image", pa.binary()),  # the whole picture, reduced
            ("body_px", _each(pa.float32(), 2 * NUM_BODY_KEYPOINTS)),  # in that picture
            ("valid", _each(_FLAG, NUM_BODY_KEYPOINTS)),
        ]
    ),
)
WEIGHTS: Final = TableSpec(
    "weights",
    1,
    ("sequence_id", "network"),
    pa.schema(
        [*_SEQUENCE, ("network", _TEXT), ("weights_file", _TEXT), ("sha256", _TEXT), ("card", _TEXT)]  # card: JSON
    ),
)
TRAINING_CURVE: Final = TableSpec(
    "training_curve",
    1,
    ("sequence_id", "step"),
    pa.schema([*_SEQUENCE, ("step", pa.int64()), ("loss", pa.float64()), ("error", pa.float64())]),
)
QUALITY: Final = TableSpec(
    "quality",
    1,
    ("sequence_id", "table", "row", "metric"),
    pa.schema(
        [*_SEQUENCE, ("table", _TEXT), ("row", _TEXT), ("metric", _TEXT), ("value", pa.float64()), ("n", pa.int64())]
    ),
)
ERRORS: Final = TableSpec(
    "errors",
    2,
    ("sequence_id", "frame", "hand", "method"),
    pa.schema(
        [
            *_HAND,
            ("method", _TEXT),  # 2d_triangulation, R1, ...: a row of the paper's tables
            ("error_mm", _each(pa.float32(), NUM_JOINTS)),  # distance to the truth; NaN where the joint is missing
            ("wrist_relative_error_mm", _each(pa.float32(), NUM_JOINTS)),  # with both wrists moved to the origin
            ("is_labelled", _each(_FLAG, NUM_JOINTS)),  # the truth is known
            ("is_own", _FLAG),  # the method found these joints itself, instead of keeping those of another
            ("verb", _TEXT),  # what is being done; empty between actions
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
            *_HAND_VIEW,
            ("labels", _TEXT),  # manual, automatic: held against whose
            ("verb", _TEXT),
            ("error_mm", _each(pa.float32(), NUM_JOINTS)),  # with both wrists at the origin; NaN where missing
            ("is_labelled", _each(_FLAG, NUM_JOINTS)),
            ("is_identity_right", _FLAG),
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
            *_SEQUENCE,
            ("table", _TEXT),  # annotation, annotation_by_finger, ...
            ("group", _TEXT),  # which finger, verb, ...; empty in the table over all
            ("row", _TEXT),  # the method
            ("metric", _TEXT),
            ("value", pa.float64()),
            ("low", pa.float64()),  # 95 % interval; NaN where there are too few instants for one
            ("high", pa.float64()),
            ("n", pa.int64()),  # joints that the value is of
            ("coverage", pa.float64()),  # found among the labelled joints, in percent
        ]
    ),
)
OVERLAYS: Final = TableSpec(
    "overlays",
    1,
    ("sequence_id", "kind", "camera_id"),
    pa.schema([*_SEQUENCE, ("kind", _TEXT), ("camera_id", _TEXT), ("overlay_file", _TEXT), ("sha256", _TEXT)]),
)
AUDIT: Final = TableSpec(
    "audit",
    1,
    ("sequence_id", "check", "camera_id"),
    pa.schema(
        [*_SEQUENCE, ("check", _TEXT), ("camera_id", _TEXT), ("level", _TEXT), ("value", pa.float64()), ("note", _TEXT)]
    ),
)
