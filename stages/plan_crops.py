"""Share out the drawing of training crops: one chunk for each short take."""

from collections.abc import Iterator
from typing import Any

from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from assemblyhands_core.synthetic.crop_draws import DURATION_S
from stages._contract import Context, Stage, StageConfig, Tables


class PlanCropsConfig(StageConfig):
    """Parameters of sharing out."""

    instants_per_take: int = Field(ge=1)


def run(config: PlanCropsConfig, inputs: Tables, context: Context) -> Tables:
    """Cut the ordered duration into takes; the frames of a take are its instants, in order."""
    (order,) = inputs["orders"].to_pylist()
    return {"chunks": CHUNKS.from_rows(list(_chunks(config, order, context)))}


def _chunks(config: PlanCropsConfig, order: dict[str, Any], context: Context) -> Iterator[dict[str, Any]]:
    for take in range(max(1, round(order["duration_s"] / DURATION_S))):
        first = take * config.instants_per_take
        yield {
            "sequence_id": context.sequence_id,
            "chunk": take,
            "first_frame": first,
            "num_frames": config.instants_per_take,
        }


STAGE = Stage(
    name="plan_crops",
    version=1,
    config=PlanCropsConfig,
    inputs={"orders": CROP_ORDERS},
    outputs={"chunks": CHUNKS},
    run=run,
    shard="sequence",
)
