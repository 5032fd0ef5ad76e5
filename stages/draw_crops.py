"""Draw crops of hands for training, directly, with their true joints: one short take of one person a chunk.

The crops are wider than a network sees, so that training can cut tighter ones out of them anew in every epoch. They
come as the tables that real recordings give (`crop_hands`), hence training reads both the same way.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from pydantic import Field

from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, CROPS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.data.training_tables import HAND_LABELS
from assemblyhands_core.synthetic.crop_boxes import AroundHand
from assemblyhands_core.synthetic.crop_draws import TrainingTake, draw_training_take, training_subject
from assemblyhands_core.synthetic.crop_mode import HandViews
from assemblyhands_core.synthetic.rig import RIGS
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals

_VIEW_STREAM: Final = 0x71E5


class DrawCropsConfig(StageConfig):
    """Parameters of drawing."""

    size_px: int = Field(ge=32, le=1024)
    gamma: float = Field(ge=1, le=6)
    gamma_spread: float = Field(ge=0, le=1)
    center_spread: float = Field(ge=0, le=0.5)
    num_views: int = Field(ge=2)
    jpeg_quality: int = Field(ge=1, le=100)


def run(config: DrawCropsConfig, inputs: Tables, context: Context) -> Tables:
    """Draw both hands at the instants of one take."""
    (order,), (chunk,) = inputs["orders"].to_pylist(), inputs["chunks"].to_pylist()
    subject = training_subject(order["split"], chunk["chunk"])
    take = draw_training_take(subject, chunk["chunk"], order["rig"], num_instants=chunk["num_frames"])
    box = AroundHand(config.gamma, config.gamma_spread, config.center_spread)
    crops: list[dict[str, Any]] = []
    labels: list[dict[str, Any]] = []
    camera_ids = _chosen_views(config, take)
    for index, views in enumerate(take.views(config.size_px, box, camera_ids)):
        frame = chunk["first_frame"] + index // 2
        name = {"sequence_id": context.sequence_id, "frame": frame, "hand": views.hand}
        crops += [name | row for row in _crop_rows(config, views, camera_ids)]
        labels.append(name | _label(views))
    return {"crops": CROPS.from_rows(crops), "labels": HAND_LABELS.from_rows(labels)}


def _chosen_views(config: DrawCropsConfig, take: TrainingTake) -> tuple[str, ...]:
    """Return some views of the take's rig, other ones in every take: more takes teach more than more views of one."""
    names = list(RIGS[take.kind](take.day_seed).exo)
    chosen = np.random.default_rng([take.take_seed, _VIEW_STREAM]).permutation(len(names))[: config.num_views]
    return tuple(names[index] for index in sorted(chosen.tolist()))


def _crop_rows(config: DrawCropsConfig, views: HandViews, camera_ids: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    for index, (camera_id, camera) in enumerate(zip(camera_ids, views.cameras, strict=True)):
        if views.is_valid[index]:
            image = encode_jpeg(views.images[index], config.jpeg_quality)
            yield {"camera_id": camera_id, **camera_to_row(camera), "image": image, "valid": True, "reason": ""}
        else:
            hole = {**missing_camera_row(), "image": b"", "valid": False, "reason": "outside_view"}
            yield {"camera_id": camera_id, **hole}


def _label(views: HandViews) -> dict[str, Any]:
    return {
        "joints_world_mm": views.joints_world_mm.ravel(),
        "valid": np.ones(len(views.joints_world_mm), dtype=bool),
        "source": "truth",
        "verb": views.verb,
        "occlusion_rate": views.occlusion_rate,
    }


STAGE = Stage(
    name="draw_crops",
    version=1,
    config=DrawCropsConfig,
    inputs={"orders": CROP_ORDERS, "chunks": CHUNKS},
    outputs={"crops": CROPS, "labels": HAND_LABELS},
    run=run,
    shard="chunk",
    externals=simulator_externals,
)
