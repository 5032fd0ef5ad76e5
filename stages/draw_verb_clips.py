"""Take clips of true poses straight from the studio's scripts, for training: nothing is filmed for them."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from pydantic import Field

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.pose_clips import PoseTracks, cut_clip
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.data.verb_clip_rows import clip_rows
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.hands.graphs import GraphName
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.take import Take
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals

_MOST_SEGMENTS: Final = 1000  # of a take


class DrawVerbClipsConfig(StageConfig):
    """Parameters of drawing."""

    sampled_hz: int = Field(ge=1, le=KEY_RATE_HZ)
    rate_hz: int = Field(ge=1, le=KEY_RATE_HZ)
    context_keys: int = Field(ge=0)
    graph: GraphName


def run(config: DrawVerbClipsConfig, inputs: Tables, context: Context) -> Tables:
    """Script one take, and cut what its hands do into segments."""
    (order,), (chunk,) = inputs["orders"].to_pylist(), inputs["chunks"].to_pylist()
    subject = training_subject(order["split"], chunk["chunk"])
    drawn = draw_training_take(subject, chunk["chunk"], order["rig"])
    take = Take.from_seed(drawn.subject, drawn.take_seed, drawn.duration_s, drawn.kind)
    tracks = _tracks(config, take)
    # A set's takes are one sequence: numbers go on from take to take, keys begin anew.
    first_number = chunk["chunk"] * _MOST_SEGMENTS
    rows = []
    for segment in _segments(take, context.sequence_id, first_number):
        clip = cut_clip(tracks, segment.first_key, segment.last_key, config.rate_hz, config.context_keys)
        rows += clip_rows(segment, clip, config.rate_hz)
    return {"clips": VERB_CLIPS.from_rows(rows)}


def _tracks(config: DrawVerbClipsConfig, take: Take) -> PoseTracks:
    times_s = np.arange(round(take.duration_s * config.sampled_hz)) / config.sampled_hz
    points = np.stack([take.joints_at(t_s) for t_s in times_s.tolist()])
    return PoseTracks.of(points, np.full(points.shape[:2], True), times_s, config.graph)


def _segments(take: Take, sequence_id: str, first_number: int) -> Iterator[VerbSegment]:
    """Yield each action once, also where both hands do the same."""
    spans = [
        (action.verb, action.noun, round(action.start_s * KEY_RATE_HZ), round(action.end_s * KEY_RATE_HZ))
        for action in take.segments
    ]
    for number, (verb, noun, first, end) in enumerate(dict.fromkeys(spans)):
        yield VerbSegment(sequence_id, first_number + number, verb, noun, first, max(first, end - 1))


STAGE = Stage(
    name="draw_verb_clips",
    version=2,
    config=DrawVerbClipsConfig,
    inputs={"orders": CROP_ORDERS, "chunks": CHUNKS},
    outputs={"clips": VERB_CLIPS},
    run=run,
    shard="chunk",
    externals=simulator_externals,
)
