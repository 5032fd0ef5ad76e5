"""Train SVEgoNet on egocentric crops: annotated by people, by our own last round, or by both (paper, Sec. 4)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.training_tables import TRAINING_CURVE, WEIGHTS
from assemblyhands_core.training.ego_dataset import PLAIN, EgoAugmentation, EgoCrops
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import REPOSITORY, ScheduleConfig, begun, fitted, is_held_out, learnt_from, training_externals

_LABELS: Final = ("manual", "automatic")
# The paper's manual and automatic sets are of different sequences; in a run without manual ones, others' labels do.
_TRAINING = {"manual": ("manual_train", "train"), "automatic": ("train",)}
_VALIDATION = {"manual": ("manual_val", "val"), "automatic": ("val",)}


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

    augmentation: EgoAugmentationConfig
    backbone: str
    num_levels: int = Field(ge=2, le=5)
    num_channels: int = Field(ge=8)
    image_size_px: int = Field(ge=32)
    num_depths: int = Field(ge=4)
    from_imagenet: bool
    backbone_from: str | None

    @property
    def backbone_path(self) -> Path | None:
        """Return the weights of the network whose backbone is taken."""
        return None if self.backbone_from is None else REPOSITORY / self.backbone_from


def run(config: TrainSvegonetConfig, inputs: Tables, context: Context) -> Tables:
    """Train on the training sequences of a run, by the labels that are given.

    Raises:
        ValueError: There are none with such labels.
    """
    import torch

    from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
    from assemblyhands_core.training.tasks import ego_task

    torch.manual_seed(config.seed)
    names = ("backbone", "num_levels", "num_channels", "image_size_px", "num_depths")
    network = SVEgoNet(SVEgoNetConfig(**{name: getattr(config, name) for name in names}))
    start = begun(network, config, config.from_imagenet, config.backbone_path)
    task = ego_task(network, *_data_sets(config, inputs))
    card = {"start": start, "labels": " and ".join(_found(inputs)), "sequences": learnt_from(inputs["members"])}
    return fitted(network, task, config, context, card, "mm")


def _data_sets(config: TrainSvegonetConfig, inputs: Tables) -> tuple[EgoCrops, EgoCrops]:
    """Return what is learnt from and what is held out: sequences of split `val`, else the last training ones."""
    training, held_out = (pa.concat_tables(_by_label(inputs, splits)) for splits in (_TRAINING, _VALIDATION))
    if not training.num_rows:
        wanted = " or ".join(dict.fromkeys(split for kind in _kinds(inputs) for split in _TRAINING[kind]))
        labels = " or ".join(_kinds(inputs))
        raise ValueError(f"no sequence of split {wanted} has egocentric crops with {labels} labels: add some")
    if not held_out.num_rows:
        is_apart = is_held_out(training, _takes(training), config.held_out_share)
        training, held_out = training.filter(pc.invert(is_apart)), training.filter(is_apart)
    augmentation = EgoAugmentation(**config.augmentation.model_dump())
    learnt = EgoCrops.of(training, augmentation, config.image_size_px, config.seed)
    judged = EgoCrops.of(held_out, PLAIN, config.image_size_px, config.seed)
    return learnt, judged.spread(config.max_held_out)


def _takes(crops: pa.Table) -> pa.Table:
    """Return what can be held out: whole sequences, of a single one its frames."""
    frames = crops.select(["sequence_id", "frame"]).rename_columns(["sequence_id", "first_frame"])
    by_sequence = frames.group_by("sequence_id").aggregate([("first_frame", "min")])
    if by_sequence.num_rows > 1:
        return by_sequence.rename_columns({"first_frame_min": "first_frame"})
    return frames.group_by(["sequence_id", "first_frame"]).aggregate([])


def _kinds(inputs: Tables) -> list[str]:
    return [kind for kind in _LABELS if kind in inputs]


def _found(inputs: Tables) -> list[str]:
    """Return the kinds of labels of which there are any."""
    return [kind for kind in _kinds(inputs) if inputs[kind].num_rows]


def _by_label(inputs: Tables, splits: Mapping[str, tuple[str, ...]]) -> list[pa.Table]:
    """Return the crops of each kind of labels, of the sequences that are for it."""
    split_of = {row["sequence_id"]: row["split"] for row in inputs["members"].to_pylist()}
    tables = [EGO_CROPS.empty()]
    for kind in _kinds(inputs):
        split = next((name for name in splits[kind] if name in split_of.values()), None)
        names = pa.array([name for name in split_of if split_of[name] == split], pa.string())
        tables.append(inputs[kind].filter(pc.is_in(inputs[kind]["sequence_id"], value_set=names)))
    return tables


def _stage(*labels: str) -> Stage[TrainSvegonetConfig]:
    return Stage(
        name="train_svegonet",
        version=3,
        config=TrainSvegonetConfig,
        inputs={"members": MEMBERS, **dict.fromkeys(labels, EGO_CROPS)},
        outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
        run=run,
        shard="set",
        uses_gpu=True,
        externals=training_externals,
    )


STAGE = _stage(*_LABELS)
ON_MANUAL = _stage("manual")
ON_AUTOMATIC = _stage("automatic")
