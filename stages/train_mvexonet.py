"""Train MVExoNet on crops of one hand from several views (paper, Sec. 3.1 and supplement B)."""

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from assemblyhands_core.data.catalog import CHUNKS, CROPS
from assemblyhands_core.data.training_tables import HAND_LABELS, TRAINING_CURVE, WEIGHTS
from stages._contract import Context, Stage, Tables
from stages._training import TrainingConfig, data_sets, fitted, started, training_externals, weights_file

if TYPE_CHECKING:
    from assemblyhands_core.models.hand_keypoints import HandKeypointNet
    from assemblyhands_core.models.mvexonet import MVExoNet


class TrainMvexonetConfig(TrainingConfig):
    """Parameters of training."""

    image_size_px: int = Field(ge=32)
    num_voxels: int = Field(ge=16)
    v2v: Literal["slim", "reference"]
    is_left_mirrored: bool

    @model_validator(mode="after")
    def _can_be_halved(self) -> Self:
        divisor = {"slim": 8, "reference": 32}[self.v2v]
        if self.num_voxels % divisor:
            raise ValueError(f"num_voxels={self.num_voxels} must be a multiple of {divisor} for v2v={self.v2v}")
        return self


def run(config: TrainMvexonetConfig, inputs: Tables, context: Context) -> Tables:
    """Train on one set of crops, starting from the encoder of the 2D network."""
    import torch

    from assemblyhands_core.models.pretrained import load_hand_keypoints
    from assemblyhands_core.training.tasks import mvexonet_task

    torch.manual_seed(config.seed)
    network = _network(config, load_hand_keypoints(weights_file(inputs["start"])))
    start = config.start_from if started(network, config) else inputs["start"]["sha256"][0].as_py()
    task = mvexonet_task(network, *data_sets(config, inputs, config.image_size_px))
    return fitted(network, task, config, context, {"start": start}, "mm")


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
    version=3,
    config=TrainMvexonetConfig,
    inputs={"chunks": CHUNKS, "crops": CROPS, "labels": HAND_LABELS, "start": WEIGHTS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="sequence",
    uses_gpu=True,
    externals=training_externals,
)
