"""Write the script of a synthetic recording: who does what with which hand, and how the filming is shared out."""

from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.studio_tables import ACTIONS, TAKES
from assemblyhands_core.synthetic.bench import Segment
from assemblyhands_core.synthetic.session import Order
from stages._contract import Context, Stage, StageConfig, Tables
from stages._simulator import simulator_externals


class ScriptTakeConfig(StageConfig):
    """Parameters of scripting."""

    chunk_frames: int = Field(ge=1, le=100_000)


def run(config: ScriptTakeConfig, inputs: Tables, context: Context) -> Tables:
    """Script one recording and cut it into chunks that can be filmed side by side."""
    order = Order.of(inputs["takes"])
    chunks = CHUNKS.from_rows(list(_chunks(config, order)))
    return {"chunks": chunks, "actions": ACTIONS.from_rows(_actions(order.write_take().segments, context))}


def _chunks(config: ScriptTakeConfig, order: Order) -> Iterator[dict[str, Any]]:
    for chunk, first in enumerate(range(0, order.num_frames, config.chunk_frames)):
        length = min(config.chunk_frames, order.num_frames - first)
        yield {"sequence_id": order.recording, "chunk": chunk, "first_frame": first, "num_frames": length}


def _actions(segments: Sequence[Segment], context: Context) -> list[dict[str, Any]]:
    return [
        {
            "sequence_id": context.sequence_id,
            "verb": segment.verb,
            "noun": segment.noun,
            "hand": segment.hand,
            "start_s": segment.start_s,
            "end_s": segment.end_s,
        }
        for segment in segments
    ]


STAGE = Stage(
    name="script_take",
    version=1,
    config=ScriptTakeConfig,
    inputs={"takes": TAKES},
    outputs={"actions": ACTIONS, "chunks": CHUNKS},
    run=run,
    shard="sequence",
    externals=simulator_externals,
)
