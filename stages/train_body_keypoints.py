"""Train the body detector on whole pictures: COCO-17 keypoints of the one person in view."""

import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.training_tables import BODY_LABELS, TRAINING_CURVE, WEIGHTS
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.training.body_dataset import BodyAugmentation, BodyViews
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import ScheduleConfig, begun, fitted, is_held_out, training_externals


class BodyAugmentationConfig(StageConfig):
    """How training pictures differ from the plain ones, see `body_dataset.BodyAugmentation`."""

    scale_spread: float = Field(ge=0, le=1)
    shift_spread: float = Field(ge=0, le=0.5)
    gain_spread: float = Field(ge=0, le=1)


class TrainBodyKeypointsConfig(ScheduleConfig):
    """Parameters of training."""

    augmentation: BodyAugmentationConfig
    backbone: str
    num_levels: int = Field(ge=2, le=5)
    num_channels: int = Field(ge=8)
    image_width_px: int = Field(ge=64)
    from_imagenet: bool


def run(config: TrainBodyKeypointsConfig, inputs: Tables, context: Context) -> Tables:
    """Train on one set of pictures."""
    import torch

    from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
    from assemblyhands_core.training.tasks import body_task

    torch.manual_seed(config.seed)
    shape = HandKeypointConfig(
        backbone=config.backbone,
        num_levels=config.num_levels,
        num_channels=config.num_channels,
        image_size_px=config.image_width_px,
        num_joints=NUM_BODY_KEYPOINTS,
        is_left_mirrored=False,
    )
    network = HandKeypointNet(shape)
    task = body_task(network, *_data_sets(config, inputs))
    start = begun(network, config, config.from_imagenet)
    return fitted(network, task, config, context, {"start": start}, "px")


def _data_sets(config: TrainBodyKeypointsConfig, inputs: Tables) -> tuple[BodyViews, BodyViews]:
    labels, is_apart = inputs["labels"], is_held_out(inputs["labels"], inputs["chunks"], config.held_out_share)
    varied = BodyAugmentation(**config.augmentation.model_dump())
    training = BodyViews.of(labels.filter(pc.invert(is_apart)), varied, config.seed)
    held_out = BodyViews.of(labels.filter(is_apart), BodyAugmentation(0.0, 0.0, 0.0), config.seed)
    return training, held_out.spread(config.max_held_out)


STAGE = Stage(
    name="train_body_keypoints",
    version=3,
    config=TrainBodyKeypointsConfig,
    inputs={"chunks": CHUNKS, "labels": BODY_LABELS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="sequence",
    uses_gpu=True,
    externals=training_externals,
)
