"""Film a synthetic recording: pictures of all cameras, and what is true in them.

Frames are independent of one another, so chunks can be filmed anywhere and in any order. Room, script and the pictures
of what never moves are kept from chunk to chunk by each process.
"""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic import Field

from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.ground_truth import TRUE_INSTANTS, TRUE_JOINTS, TRUE_VIEWS, ground_truth_tables
from assemblyhands_core.data.studio_tables import FOOTAGE, TAKES
from assemblyhands_core.data.video_writer import VideoWriter
from assemblyhands_core.synthetic.session import Order, Session, Shot
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals


class FilmTakeConfig(StageConfig):
    """Parameters of filming."""

    crf: int = Field(ge=0, le=51)


def run(config: FilmTakeConfig, inputs: Tables, context: Context) -> Tables:
    """Film one chunk of frames."""
    session = _session(Order.of(inputs["takes"]))
    (chunk,) = inputs["chunks"].to_pylist()
    frames = range(chunk["first_frame"], chunk["first_frame"] + chunk["num_frames"])
    shots = list(_film(config, session, frames, context))
    return {
        "footage": FOOTAGE.from_rows([_footage_row(camera_id, frames, context) for camera_id in session.camera_ids]),
        **ground_truth_tables(context.sequence_id, [shot.truth for shot in shots]),
    }


@lru_cache(1)
def _session(order: Order) -> Session:
    return Session(order)


def _film(config: FilmTakeConfig, session: Session, frames: range, context: Context) -> Iterator[Shot]:
    """Write the videos of some frames; yield what they show, without the pictures."""
    with ExitStack() as stack:
        writers: dict[str, VideoWriter] = {}
        for frame in frames:
            shot = session.shoot(frame)
            for camera_id, image in shot.images.items():
                if camera_id not in writers:
                    path = context.blob_dir / blob_name(camera_id, ".mp4")
                    writer = VideoWriter(path, image.shape[1], image.shape[0], session.rate_hz, config.crf)
                    writers[camera_id] = stack.enter_context(writer)
                writers[camera_id].write(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=-1))
            yield replace(shot, images={})


def _footage_row(camera_id: str, frames: range, context: Context) -> dict[str, Any]:
    name = blob_name(camera_id, ".mp4")
    return {
        "sequence_id": context.sequence_id,
        "camera_id": camera_id,
        "first_frame": frames.start,
        "num_frames": len(frames),
        "video_file": name,
        "sha256": digest_file(context.blob_dir / name),
    }


STAGE = Stage(
    name="film_take",
    version=2,
    config=FilmTakeConfig,
    inputs={"takes": TAKES, "chunks": CHUNKS},
    outputs={
        "footage": FOOTAGE,
        "true_joints": TRUE_JOINTS,
        "true_views": TRUE_VIEWS,
        "true_instants": TRUE_INSTANTS,
    },
    run=run,
    shard="chunk",
    externals=simulator_externals,
)
