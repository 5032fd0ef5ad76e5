"""Train MVExoNet on crops of one hand from several views (paper, Sec. 3.1 and supplement B)."""

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from assemblyhands_core.data.catalog import CROPS, HAND_LABELS, TRAINING_CURVE, WEIGHTS
from assemblyhands_core.models.hand_keypoints import HandKeypointNet
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet, MVExoNetConfig
from assemblyhands_core.models.pretrained import load_hand_keypoints
from assemblyhands_core.training.loop import Batch, Task
from stages._contract import Context, Stage, Tables
from stages._training import TrainingConfig, data_sets, fitted, mean_distance, tensors, weights_file


class TrainMvexonetConfig(TrainingConfig):
    """Parameters of training."""

    image_size_px: int = Field(ge=32)
    num_voxels: int = Field(ge=16)
    v2v: Literal["slim", "reference"]
    is_left_mirrored: bool


def run(config: TrainMvexonetConfig, inputs: Tables, context: Context) -> Tables:
    """Train on one set of crops, starting from the encoder of the 2D network."""
    torch.manual_seed(config.seed)
    start = load_hand_keypoints(weights_file(inputs["start"]))
    network = _network(config, start)
    training, held_out = data_sets(config, inputs, config.image_size_px)

    def estimate(batch: Batch) -> tuple[dict[str, Tensor], HandEstimate]:
        sample = tensors(batch)
        names = ("images", "P_pixel_from_world", "is_view_used", "root_world_mm", "is_left")
        return sample, network(*(sample[name] for name in names))

    def loss(batch: Batch) -> Tensor:
        sample, found = estimate(batch)
        names = ("joints_world_mm", "is_valid", "root_world_mm", "is_left")
        return network.loss(found, *(sample[name] for name in names))

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        sample, found = estimate(batch)
        return mean_distance(found.joints_world_mm, sample["joints_world_mm"], sample["is_valid"])

    card = {"start": inputs["start"]["sha256"][0].as_py()}
    return fitted(network, Task(network, loss, error, training, held_out), config, context, card, "mm")


def _network(config: TrainMvexonetConfig, start: HandKeypointNet) -> MVExoNet:
    shape = MVExoNetConfig(
        backbone=start.config.backbone,
        num_levels=start.config.num_levels,
        num_channels=start.config.num_channels,
        image_size_px=config.image_size_px,
        num_voxels=config.num_voxels,
        v2v=config.v2v,
        is_left_mirrored=config.is_left_mirrored,
    )
    network = MVExoNet(shape)
    network.encoder.load_state_dict(start.encoder.state_dict())
    return network


STAGE = Stage(
    name="train_mvexonet",
    version=1,
    config=TrainMvexonetConfig,
    inputs={"crops": CROPS, "labels": HAND_LABELS, "start": WEIGHTS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="sequence",
)
