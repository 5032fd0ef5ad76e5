"""What is true in a synthetic recording, at every frame of its 30 Hz videos; only evaluation may read it.

`frame` counts frames of the videos; AssemblyHands' key of frame n is 2 n. A joint is *in* an image when its projection
through the real lens is, and *visible* there when moreover nothing lies between camera and hand. The occlusion rate is
the share of hidden joints among those in the image.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float64

from assemblyhands_core.data.names import ego_serial
from assemblyhands_core.data.tables import TableSpec, read_parquet, write_parquet
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS

_FRAME_KEY: Final = ("sequence_id", "frame")
_FRAME_COLUMNS: Final = [("sequence_id", pa.string()), ("frame", pa.int64())]

TRUE_JOINTS: Final = TableSpec(
    "true_joints",
    1,
    (*_FRAME_KEY, "hand"),
    pa.schema([*_FRAME_COLUMNS, ("hand", pa.string()), ("joints_world_mm", pa.list_(pa.float32(), 3 * NUM_JOINTS))]),
)
TRUE_VIEWS: Final = TableSpec(
    "true_views",
    1,
    (*_FRAME_KEY, "hand", "camera_id"),
    pa.schema(
        [
            *_FRAME_COLUMNS,
            ("hand", pa.string()),
            ("camera_id", pa.string()),
            ("joints_px", pa.list_(pa.float32(), 2 * NUM_JOINTS)),  # in the raw video; NaN where the lens has no pixel
            ("is_in_image", pa.list_(pa.bool_(), NUM_JOINTS)),
            ("is_visible", pa.list_(pa.bool_(), NUM_JOINTS)),
            ("occlusion_rate", pa.float32()),  # NaN when no joint is in the image
        ]
    ),
)
TRUE_INSTANTS: Final = TableSpec(
    "true_instants",
    1,
    _FRAME_KEY,
    pa.schema(
        [
            *_FRAME_COLUMNS,
            ("exo_occlusion_rate", pa.float32()),  # over all exocentric views, both hands
            ("ego_occlusion_rate", pa.float32()),
            ("verb", pa.string()),  # empty between actions
            ("noun", pa.string()),
            ("T_headset_from_world", pa.list_(pa.float64(), 16)),  # 4x4 by rows, mm; NaN without headset
        ]
    ),
)
GROUND_TRUTH: Final = (TRUE_JOINTS, TRUE_VIEWS, TRUE_INSTANTS)


@dataclass(frozen=True, eq=False)
class TrueInstant:
    """What is true at one frame.

    Attributes:
        frame: Of the 30 Hz videos.
        joints_world_mm: Right hand first.
        cameras: All cameras in the world at this instant.
        is_unoccluded: For every camera, the joints that nothing hides; whether they are in the image is found out here.
        T_headset_from_world: Pose of the headset; None without one.
        verb: What is being done; empty between actions.
        noun: With what.
    """

    frame: int
    joints_world_mm: Float64[np.ndarray, "hand=2 joint=21 xyz=3"]
    cameras: Mapping[str, Camera]
    is_unoccluded: Mapping[str, Bool[np.ndarray, "hand=2 joint=21"]]
    T_headset_from_world: Float64[np.ndarray, "4 4"] | None = None
    verb: str = ""
    noun: str = ""


def ground_truth_tables(sequence_id: str, instants: Iterable[TrueInstant]) -> dict[str, pa.Table]:
    """Return the tables of `GROUND_TRUTH` by name, for some frames of one recording."""
    rows: dict[str, list[Mapping[str, Any]]] = {spec.name: [] for spec in GROUND_TRUTH}
    for instant in instants:
        key = {"sequence_id": sequence_id, "frame": instant.frame}
        views = [key | row for camera_id in instant.cameras for row in _view_rows(instant, camera_id)]
        rows[TRUE_VIEWS.name] += views
        rows[TRUE_JOINTS.name] += [
            key | {"hand": hand, "joints_world_mm": joints.ravel()}
            for hand, joints in zip(HANDS, instant.joints_world_mm, strict=True)
        ]
        rows[TRUE_INSTANTS.name].append(key | _instant_row(instant, views))
    return {spec.name: spec.from_rows(rows[spec.name]) for spec in GROUND_TRUTH}


def write_ground_truth(folder: Path, tables: Mapping[str, pa.Table]) -> None:
    """Write the tables of a recording, one Parquet file each."""
    folder.mkdir(parents=True, exist_ok=True)
    for spec in GROUND_TRUTH:
        write_parquet(folder / f"{spec.name}.parquet", tables[spec.name], spec, {"source": "simulator"})


def read_ground_truth(folder: Path, spec: TableSpec) -> pa.Table:
    """Read one table of a recording's ground truth.

    Raises:
        TableError: The file is missing or damaged, or holds something else.
    """
    return read_parquet(folder / f"{spec.name}.parquet", spec)


def _view_rows(instant: TrueInstant, camera_id: str) -> list[dict[str, Any]]:
    camera = instant.cameras[camera_id]
    pixels = camera.project(instant.joints_world_mm)
    is_in_image = camera.contains(pixels)
    is_visible = is_in_image & instant.is_unoccluded[camera_id]
    return [
        {
            "hand": hand,
            "camera_id": camera_id,
            "joints_px": pixels[index].ravel(),
            "is_in_image": is_in_image[index],
            "is_visible": is_visible[index],
            "occlusion_rate": _hidden_share([is_in_image[index]], [is_visible[index]]),
        }
        for index, hand in enumerate(HANDS)
    ]


def _instant_row(instant: TrueInstant, views: list[dict[str, Any]]) -> dict[str, Any]:
    pose = np.full((4, 4), np.nan) if instant.T_headset_from_world is None else instant.T_headset_from_world
    row: dict[str, Any] = {"verb": instant.verb, "noun": instant.noun, "T_headset_from_world": pose.ravel()}
    for name, is_ego in (("exo", False), ("ego", True)):
        chosen = [view for view in views if (ego_serial(view["camera_id"]) is not None) == is_ego]
        in_image, visible = ([view[column] for view in chosen] for column in ("is_in_image", "is_visible"))
        row[f"{name}_occlusion_rate"] = _hidden_share(in_image, visible)
    return row


def _hidden_share(is_in_image: list[Any], is_visible: list[Any]) -> float:
    seen = int(np.sum(is_in_image))
    return 1.0 - int(np.sum(is_visible)) / seen if seen else float("nan")
