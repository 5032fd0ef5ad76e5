"""Write the headset's rectified pictures with all that is known of the hands in them, for others to train on.

A picture is written where at least one hand would become a crop (`project_ego`); its rows are what the AssemblyHands
and COCO files of an export are made of.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field

from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.camera_rows import camera_to_row
from assemblyhands_core.data.crop_images import ImageRGB, encode_jpeg
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.ego_boxes import EgoBox, EgoRule
from assemblyhands_core.data.ego_tables import EGO_PICTURES
from assemblyhands_core.data.ego_views import EGO_INPUTS, EgoHands, EgoView, ego_hands, ego_views
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import remap
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from stages._contract import Context, Stage, StageConfig, Tables

Row = dict[str, Any]
Flags = npt.NDArray[np.bool_]


class WriteEgoPicturesConfig(StageConfig):
    """Parameters of the pictures; the rule is `project_ego`'s."""

    jpeg_quality: int = Field(ge=1, le=100)
    min_joints: int = Field(ge=1, le=NUM_JOINTS)
    min_border_px: float

    def rule(self) -> EgoRule:
        """Return which hands count."""
        return EgoRule(1.0, self.min_joints, self.min_border_px, 1.0)


def run(config: WriteEgoPicturesConfig, inputs: Tables, context: Context) -> Tables:
    """Write the pictures of one chunk of frames."""
    hands = ego_hands(inputs)
    rows = [row for view in ego_views(inputs) for row in _rows(config, view, hands, context)]
    return {"pictures": EGO_PICTURES.from_rows([{"sequence_id": context.sequence_id, **row} for row in rows])}


def _rows(
    config: WriteEgoPicturesConfig, view: EgoView, hands: Mapping[int, EgoHands], context: Context
) -> Iterator[Row]:
    boxes = {frame: view.hand_boxes(frame, both, config.rule()) for frame, both in hands.items()}
    wanted = [frame for frame, both in boxes.items() if any(not box.reason for box in both)]
    maps = view.grid.window(view.rectified)
    for frame, picture in view.pictures(wanted, context.num_threads):
        if not isinstance(picture, str) and frame in wanted:
            file = _written(remap(picture, *maps), f"{view.camera_id}-{frame:06d}", config.jpeg_quality, context)
            known = view.known_joints(frame, hands[frame])
            yield {**file, **_labels(view.camera_at(frame), hands[frame], known, boxes[frame]), "frame": frame}


def _written(picture: ImageRGB, name: str, quality: int, context: Context) -> Row:
    path = context.blob_dir / blob_name(name, ".jpg")
    path.write_bytes(encode_jpeg(picture, quality))
    return {"picture_file": path.name, "sha256": digest_file(path)}


def _labels(camera: Camera, hands: EgoHands, is_known: Flags, boxes: list[EgoBox]) -> Row:
    """Return camera, joints and the tight boxes of the hands that count."""
    pixels, size_px = camera.project(hands.joints_world_mm), np.array([camera.width_px, camera.height_px])
    tight = np.full((len(HANDS), 4), np.nan)
    for index, box in enumerate(boxes):
        if not box.reason and is_known[index].any():
            shown = np.clip(pixels[index][is_known[index]], 0.0, size_px - 1.0)
            tight[index] = [*shown.min(axis=0), *shown.max(axis=0)]
    return {
        "camera_id": camera.camera_id,
        **camera_to_row(camera),
        "joints_px": pixels.ravel(),
        "is_labelled": (is_known & camera.contains(pixels)).ravel(),
        "box_px": tight.ravel(),
    }


STAGE = Stage(
    name="write_ego_pictures",
    version=1,
    config=WriteEgoPicturesConfig,
    inputs=EGO_INPUTS,
    outputs={"pictures": EGO_PICTURES},
    run=run,
    shard="chunk",
)
