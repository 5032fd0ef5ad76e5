"""Train SVEgoNet on egocentric crops: annotated by people, by our own last round, or by both (paper, Sec. 4)."""

from typing import Literal

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import CHUNKS, EGO_CROPS, MEMBERS, TRAINING_CURVE, WEIGHTS
from assemblyhands_core.training.ego_dataset import PLAIN, EgoAugmentation, EgoCrops
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import ScheduleConfig, fitted, is_held_out, started, training_externals

TRAINING, VALIDATION = "train", "val"


class EgoAugmentationConfig(StageConfig):
    """How training crops differ from the plain ones, see `ego_dataset.EgoAugmentation`."""

    scale_spread: float = Field(ge=0, le=1)
    shift_spread: float = Field(ge=0, le=0.5)
    turn_deg: float = Field(ge=0, le=180)
    flip_share: float = Field(ge=0, le=1)
    gain_spread: float = Field(ge=0, le=1)
    noise_spread: float = Field(ge=0, le=1)


class TrainSvegonetConfig(ScheduleConfig):
    """Parameters of training."""

    labels: Literal["manual", "automatic", "both"]
    augmentation: EgoAugmentationConfig
    backbone: str
    num_levels: int = Field(ge=2, le=5)
    num_channels: int = Field(ge=8)
    image_size_px: int = Field(ge=32)
    num_depths: int = Field(ge=4)
    from_imagenet: bool


def run(config: TrainSvegonetConfig, inputs: Tables, context: Context) -> Tables:
    """Train on the training sequences of a run.

    Raises:
        ValueError: There are none, or they have no such labels.
    """
    import torch

    from assemblyhands_core.models.pretrained import start_from_imagenet
    from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
    from assemblyhands_core.training.tasks import ego_task

    torch.manual_seed(config.seed)
    names = ("backbone", "num_levels", "num_channels", "image_size_px", "num_depths")
    network = SVEgoNet(SVEgoNetConfig(**{name: getattr(config, name) for name in names}))
    if not started(network, config) and config.from_imagenet:
        start_from_imagenet(network.encoder)
    task = ego_task(network, *_data_sets(config, inputs))
    start = config.start_from or ("ImageNet" if config.from_imagenet else "random")
    return fitted(network, task, config, context, {"start": start, "labels": config.labels}, "mm")


def _data_sets(config: TrainSvegonetConfig, inputs: Tables) -> tuple[EgoCrops, EgoCrops]:
    """Return what is learnt from and what is held out: sequences of split `val`, else the last training takes."""
    wanted = ("manual", "automatic") if config.labels == "both" else (config.labels,)
    crops = pa.concat_tables([inputs[name] for name in wanted])
    training, held_out = (_of_split(crops, inputs["members"], split) for split in (TRAINING, VALIDATION))
    if not training.num_rows:
        raise ValueError(
            f"no sequence of split {TRAINING} has egocentric crops with {config.labels} labels: add some to the run"
        )
    if not held_out.num_rows:
        is_apart = is_held_out(
            training, _of_split(inputs["chunks"], inputs["members"], TRAINING), config.held_out_share
        )
        training, held_out = training.filter(pc.invert(is_apart)), training.filter(is_apart)
    augmentation = EgoAugmentation(**config.augmentation.model_dump())
    learnt = EgoCrops.of(training, augmentation, config.image_size_px, config.seed)
    judged = EgoCrops.of(held_out, PLAIN, config.image_size_px, config.seed)
    return learnt, judged.spread(config.max_held_out)


def _of_split(rows: pa.Table, members: pa.Table, split: str) -> pa.Table:
    names = members.filter(pc.equal(members["split"], split))["sequence_id"]
    return rows.filter(pc.is_in(rows["sequence_id"], value_set=names.combine_chunks()))


STAGE = Stage(
    name="train_svegonet",
    version=1,
    config=TrainSvegonetConfig,
    inputs={"members": MEMBERS, "chunks": CHUNKS, "manual": EGO_CROPS, "automatic": EGO_CROPS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="set",
    externals=training_externals,
)
