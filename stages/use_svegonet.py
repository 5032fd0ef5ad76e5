"""Take the weights of SVEgoNet that are shipped, or of one's own."""

from collections.abc import Mapping

from assemblyhands_core.data.training_tables import WEIGHTS
from stages._contract import Context, Stage, Tables
from stages._shipped_weights import UseWeightsConfig, copied_weights, weights_externals


def run(config: UseWeightsConfig, inputs: Tables, context: Context) -> Tables:
    """Take them."""
    return copied_weights(config, "SVEgoNet", context)


def externals(config: UseWeightsConfig, sequence_id: str) -> Mapping[str, str]:
    """Return their digest."""
    return weights_externals(config, "use_svegonet.weights", "train_ego")


STAGE = Stage(
    name="use_svegonet",
    version=1,
    config=UseWeightsConfig,
    inputs={},
    outputs={"weights": WEIGHTS},
    run=run,
    shard="set",
    externals=externals,
)
