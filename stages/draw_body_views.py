"""Draw small whole pictures with the true keypoints of the body in them, to train the body detector."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.data.training_tables import BODY_LABELS
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.body_keypoints import body_keypoints_mm
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.crop_mode import CropInstant
from assemblyhands_core.synthetic.render import render_crops
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals

_VIEW_STREAM = 0xB0D1


class DrawBodyViewsConfig(StageConfig):
    """Parameters of drawing."""

    width_px: int = Field(ge=64, le=1920)
    every_nth_take: int = Field(ge=1)
    num_instants: int = Field(ge=1)
    num_views: int = Field(ge=1)
    jpeg_quality: int = Field(ge=1, le=100)


def run(config: DrawBodyViewsConfig, inputs: Tables, context: Context) -> Tables:
    """Draw some views at some instants of one take."""
    (order,), (chunk,) = inputs["orders"].to_pylist(), inputs["chunks"].to_pylist()
    if config.num_instants > chunk["num_frames"]:
        raise ValueError(
            f"draw_body_views.num_instants={config.num_instants} is more than the {chunk['num_frames']} of a take "
            "(plan_crops.instants_per_take)"
        )
    if chunk["chunk"] % config.every_nth_take:
        return {"labels": BODY_LABELS.empty()}
    subject = training_subject(order["split"], chunk["chunk"])
    take = draw_training_take(subject, chunk["chunk"], order["rig"], num_instants=config.num_instants)
    studio, rng = take.open(), np.random.default_rng([take.take_seed, _VIEW_STREAM])
    rows: list[dict[str, Any]] = []
    for index, t_s in enumerate(take.times_s):
        instant = studio.at(t_s)
        name = {"sequence_id": context.sequence_id, "frame": chunk["first_frame"] + index}
        views = rng.permutation(len(instant.sources))[: config.num_views]
        rows += [name | row for row in _views(config, instant, sorted(views.tolist()))]
    return {"labels": BODY_LABELS.from_rows(rows)}


def _views(config: DrawBodyViewsConfig, instant: CropInstant, views: list[int]) -> Iterator[dict[str, Any]]:
    cameras = [_small(instant.sources[view], config.width_px) for view in views]
    sensors = [instant.sensors[view] for view in views]
    frame_seed = round(1000 * instant.state.t_s)
    drawn = render_crops(instant.scene, cameras, sensors=sensors, frame_seed=frame_seed, background_cache=instant.cache)
    points = body_keypoints_mm(instant.state)
    for camera, picture in zip(cameras, drawn, strict=True):
        pixels = camera.project(points)
        is_valid = np.isfinite(pixels).all(axis=-1) & camera.contains(np.nan_to_num(pixels, nan=-1e6))
        yield {
            "camera_id": camera.camera_id,
            "image": encode_jpeg(picture.image, config.jpeg_quality),
            "body_px": np.where(is_valid[:, None], pixels, np.nan).ravel(),
            "valid": is_valid,
        }


def _small(camera: Camera, width_px: int) -> Camera:
    return camera.scaled(width_px, round(width_px * camera.height_px / camera.width_px))


STAGE = Stage(
    name="draw_body_views",
    version=1,
    config=DrawBodyViewsConfig,
    inputs={"orders": CROP_ORDERS, "chunks": CHUNKS},
    outputs={"labels": BODY_LABELS},
    run=run,
    shard="chunk",
    externals=simulator_externals,
)
