"""Draw crops of the headset's pictures for training, directly, with their true joints: one short take a chunk.

They come as the table that annotated recordings give (`project_ego`), hence training reads both the same way. A crop
costs a twentieth of one that is filmed and annotated.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.ego_boxes import OUTSIDE_VIEW, ego_box
from assemblyhands_core.data.ego_crop_rows import ego_crop_row, ego_hole_row
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from assemblyhands_core.synthetic.crop_boxes import Windows
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.crop_mode import CropInstant
from assemblyhands_core.synthetic.rig import RIGS
from stages._contract import Context, Stage, Tables
from stages._ego_crops import EgoCropsConfig
from stages._simulator import simulator_externals

Row = Mapping[str, Any]


class DrawEgoCropsConfig(EgoCropsConfig):
    """Parameters of drawing: those by which recordings are cropped."""

    size_px: int = Field(ge=32, le=1024)


def run(config: DrawEgoCropsConfig, inputs: Tables, context: Context) -> Tables:
    """Draw both hands in all cameras of the headset at the instants of one take."""
    (order,), (chunk,) = inputs["orders"].to_pylist(), inputs["chunks"].to_pylist()
    subject = training_subject(order["split"], chunk["chunk"])
    take = draw_training_take(subject, chunk["chunk"], order["rig"], num_instants=chunk["num_frames"])
    camera_ids = tuple(RIGS[take.kind](take.day_seed).ego)
    studio = take.open(camera_ids)
    rows = [
        {"sequence_id": context.sequence_id, "frame": chunk["first_frame"] + index, "hand": hand, **row}
        for index, t_s in enumerate(take.times_s)
        for hand in HANDS
        for row in _rows(config, studio.at(t_s), camera_ids, hand)
    ]
    return {"crops": EGO_CROPS.from_rows(rows)}


def _rows(config: DrawEgoCropsConfig, instant: CropInstant, camera_ids: tuple[str, ...], hand: Hand) -> Iterator[Row]:
    """Yield what becomes of a hand in each camera."""
    joints = instant.state.joints_world_mm.reshape(len(HANDS), NUM_JOINTS, 3)
    is_known, rule = np.full(joints.shape[:2], True), config.rule()
    own = HANDS.index(hand)
    boxes = [
        ego_box(camera.project(joints[own]), is_known[own], (camera.width_px, camera.height_px), rule)
        for camera in instant.rectified
    ]
    centers_px = np.stack([box.center_px for box in boxes])
    windows = Windows(centers_px, np.array([box.side_px for box in boxes]))
    views = instant.hand_views(hand, config.size_px, windows)
    for camera_id, box, rectified, *picture, is_valid in zip(
        camera_ids, boxes, instant.rectified, views.images, views.cameras, views.is_valid, strict=True
    ):
        if box.reason or not is_valid:
            yield {"camera_id": camera_id, **ego_hole_row(box, OUTSIDE_VIEW)}
            continue
        image, camera = picture
        row = ego_crop_row(
            (image, camera), rectified, joints, is_known, hand, box, rule, jpeg_quality=config.jpeg_quality
        )
        yield {"camera_id": camera_id, **row, "verb": views.verb, "source": "truth"}


STAGE = Stage(
    name="draw_ego_crops",
    version=1,
    config=DrawEgoCropsConfig,
    inputs={"orders": CROP_ORDERS, "chunks": CHUNKS},
    outputs={"crops": EGO_CROPS},
    run=run,
    shard="chunk",
    externals=simulator_externals,
)
