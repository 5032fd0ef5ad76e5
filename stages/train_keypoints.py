"""Train the 2D network on crops: 21 joints of one hand in one view (paper, Sec. 3.1, "2D + Triangulation")."""

import torch
from pydantic import Field
from torch import Tensor

from assemblyhands_core.data.catalog import CROPS, HAND_LABELS, TRAINING_CURVE, WEIGHTS
from assemblyhands_core.models.hand_keypoints import HandKeypointConfig, HandKeypointNet
from assemblyhands_core.models.pretrained import start_from_imagenet
from assemblyhands_core.training.loop import Batch, Task
from stages._contract import Context, Stage, Tables
from stages._training import TrainingConfig, data_sets, fitted, mean_distance, tensors


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
    torch.manual_seed(config.seed)
    shape = {name: getattr(config, name) for name in ("backbone", "num_levels", "num_channels", "image_size_px")}
    network = HandKeypointNet(HandKeypointConfig(**shape, is_left_mirrored=config.is_left_mirrored))
    if config.from_imagenet:
        start_from_imagenet(network.encoder)
    training, held_out = data_sets(config, inputs, config.image_size_px)

    def loss(batch: Batch) -> Tensor:
        images, pixels, is_valid, is_left = _views(batch, config.image_size_px)
        return network.loss(network(images, is_left), pixels, is_valid, is_left)

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        images, pixels, is_valid, is_left = _views(batch, config.image_size_px)
        return mean_distance(network(images, is_left).pixels, pixels, is_valid)

    card = {"start": "ImageNet" if config.from_imagenet else "random"}
    return fitted(network, Task(network, loss, error, training, held_out), config, context, card, "px")


def _views(batch: Batch, size_px: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return pictures, true pixels, which of them count and the side, one row for each view that is used.

    A joint counts where it lies in the picture, hidden or not.
    """
    sample = tensors(batch)
    used = sample["is_view_used"]
    num_views = used.shape[1]
    points = torch.nn.functional.pad(sample["joints_world_mm"], (0, 1), value=1.0)
    projected = torch.einsum("bvij,bkj->bvki", sample["P_pixel_from_world"], points)[used]
    pixels = projected[..., :2] / projected[..., 2:].clamp(min=1e-6)
    inside = ((pixels > -0.5) & (pixels < size_px - 0.5)).all(dim=-1) & (projected[..., 2] > 0)
    is_valid = sample["is_valid"][:, None].expand(-1, num_views, -1)[used] & inside
    is_left = sample["is_left"][:, None].expand(-1, num_views)[used]
    return sample["images"][used], torch.where(inside[..., None], pixels, 0.0), is_valid, is_left


STAGE = Stage(
    name="train_keypoints",
    version=1,
    config=TrainKeypointsConfig,
    inputs={"crops": CROPS, "labels": HAND_LABELS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="sequence",
)
