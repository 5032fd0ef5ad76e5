"""Train the 2D network on crops: 21 joints of one hand in one view (paper, Sec. 3.1, "2D + Triangulation")."""

from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS, CROPS
from assemblyhands_core.data.training_tables import HAND_LABELS, TRAINING_CURVE, WEIGHTS
from stages._contract import Context, Stage, Tables
from stages._training import TrainingConfig, begun, data_sets, fitted, training_externals


class TrainKeypointsConfig(TrainingConfig):
    """Parameters of training."""

    backbone: str
    num_levels: int = Field(ge=2, le=5)
    num_channels: int = Field(ge=8)
    image_size_px: int = Field(ge=32)
    is_left_mirrored: bool
    from_imagenet: bool


def run(config: TrainKeypointsConfig, inputs: Tables, context: Context) -> Tables:
    """Train on one set of crops."""
    import torch

    from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
    from assemblyhands_core.training.tasks import keypoint_task

    torch.manual_seed(config.seed)
    shape = {name: getattr(config, name) for name in ("backbone", "num_levels", "num_channels", "image_size_px")}
    network = HandKeypointNet(HandKeypointConfig(**shape, is_left_mirrored=config.is_left_mirrored))
    task = keypoint_task(network, *data_sets(config, inputs, config.image_size_px))
    start = begun(network, config, config.from_imagenet)
    return fitted(network, task, config, context, {"start": start}, "px")


STAGE = Stage(
    name="train_keypoints",
    version=3,
    config=TrainKeypointsConfig,
    inputs={"chunks": CHUNKS, "crops": CROPS, "labels": HAND_LABELS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="sequence",
    uses_gpu=True,
    externals=training_externals,
)
