"""Train MVExoNet on crops of one hand from several views (paper, Sec. 3.1 and supplement B)."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from assemblyhands_core.data.catalog import CROPS, HAND_LABELS, TRAINING_CURVE, WEIGHTS
from stages._contract import Context, Stage, Tables
from stages._training import TrainingConfig, data_sets, fitted, weights_file

if TYPE_CHECKING:
    from assemblyhands_core.models.hand_keypoints import HandKeypointNet
    from assemblyhands_core.models.mvexonet import MVExoNet


class TrainMvexonetConfig(TrainingConfig):
    """Parameters of training."""

    image_size_px: int = Field(ge=32)
    num_voxels: int = Field(ge=16)
    v2v: Literal["slim", "reference"]
    is_left_mirrored: bool


def run(config: TrainMvexonetConfig, inputs: Tables, context: Context) -> Tables:
    """Train on one set of crops, starting from the encoder of the 2D network."""
    import torch

    from assemblyhands_core.models.pretrained import load_hand_keypoints
    from assemblyhands_core.training.tasks import mvexonet_task

    torch.manual_seed(config.seed)
    network = _network(config, load_hand_keypoints(weights_file(inputs["start"])))
    task = mvexonet_task(network, *data_sets(config, inputs, config.image_size_px))
    return fitted(network, task, config, context, {"start": inputs["start"]["sha256"][0].as_py()}, "mm")


def _network(config: TrainMvexonetConfig, start: "HandKeypointNet") -> "MVExoNet":
    """Return a network whose encoder is that of the 2D network."""
    from assemblyhands_core.models.mvexonet import MVExoNet, MVExoNetConfig

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
