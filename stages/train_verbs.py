"""Train MS-G3D to tell verbs from clips of hand poses of one source, in the training sequences (paper, Sec. 5)."""

from collections.abc import Sequence
from typing import Literal, Self

import pyarrow as pa
from pydantic import Field, model_validator

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.members import TRAINING_SPLITS, VALIDATION_SPLITS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import Centre, Length, PoseSequenceConfig, Scale
from assemblyhands_core.data.training_tables import TRAINING_CURVE, WEIGHTS
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.training.verb_dataset import PLAIN, Mirroring, VerbAugmentation, VerbClips
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import ScheduleConfig, fitted, is_held_out, learnt_from, started, training_externals

Clip = tuple[VerbSegment, PoseClip]


class VerbAugmentationConfig(StageConfig):
    """How training clips differ from the plain ones, see `verb_dataset.VerbAugmentation`."""

    crop_share: float = Field(ge=0, le=1)
    speed_spread: float = Field(ge=0, le=1)
    turn_deg: float = Field(ge=0, le=180)
    vertical: tuple[float, float, float]
    noise_mm: float = Field(ge=0)
    mirroring: Mirroring
    mirror_share: float = Field(ge=0, le=1)


class TrainVerbsConfig(ScheduleConfig):
    """Parameters of training."""

    verbs: tuple[str, ...]
    num_frames: int = Field(ge=8)
    length: Length
    centre: Centre
    scale: Scale
    num_gcn_scales: int = Field(ge=1)
    num_g3d_scales: int = Field(ge=1)
    num_channels: tuple[int, int, int]
    object_cue: bool
    dropout: float = Field(ge=0, lt=1)
    oversampling: dict[str, int]
    augmentation: VerbAugmentationConfig
    labels: Literal["true", "shuffled"]

    @model_validator(mode="after")
    def _a_control_knows_nothing(self) -> Self:
        if self.labels == "shuffled" and self.start_from is not None:
            raise ValueError(
                f"labels=shuffled is a control, and {self.start_from} has learnt from true labels: set start_from=null"
            )
        return self


def run(config: TrainVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Train on the clips of the training sequences; where none has poses in segments with verbs, nothing is trained.

    Raises:
        ValueError: Clips differ in their graph or rate.
    """
    import torch

    from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
    from assemblyhands_core.models.verb_classification import VerbClassifier
    from assemblyhands_core.training.tasks import verb_task

    torch.manual_seed(config.seed)
    training, held_out = _split(config, inputs)
    if not training:  # others of a run's sources of poses may have some
        return {"weights": WEIGHTS.empty(), "curve": TRAINING_CURVE.empty()}
    sequence = _sequence(config, inputs["clips"])
    nouns = tuple(sorted({segment.noun for segment, _ in training})) if config.object_cue else ()
    shape = MSG3DConfig(
        len(config.verbs),
        config.num_gcn_scales,
        config.num_g3d_scales,
        *config.num_channels,
        graph=sequence.graph,
        dropout=config.dropout,
        num_frame_features=len(nouns),
    )
    network = MSG3D(shape)
    start = str(config.start_from) if started(network, config) else "random"
    learnt = _clips(config, training, nouns, sequence, VerbAugmentation(**config.augmentation.model_dump()))
    judged = _clips(config, held_out, nouns, sequence, PLAIN)
    task = verb_task(network, learnt, judged.spread(config.max_held_out))
    card = {
        "start": start,
        "sequences": learnt_from(inputs["members"]),
        **VerbClassifier.card(config.verbs, nouns, sequence),
    }
    return fitted(network, task, config, context, card, "percent")


def _split(config: TrainVerbsConfig, inputs: Tables) -> tuple[list[Clip], list[Clip]]:
    """Return what is learnt from and what is held out: sequences of split `val`, else the last ones for training.

    Where there is a single one, it is its last segments. Segments in which no hand was seen are in neither.
    """
    members = inputs["members"]
    splits = dict(zip(members["sequence_id"].to_pylist(), members["split"].to_pylist(), strict=True))
    seen = [(splits.get(one.recording, ""), (one, clip)) for one, clip in clips_of(inputs["clips"]) if clip.coverage]
    training = [clip for split, clip in seen if split in TRAINING_SPLITS]
    held_out = [clip for split, clip in seen if split in VALIDATION_SPLITS]
    if held_out or not training:
        return training, held_out
    is_apart = _is_last(config, training)
    parts = list(zip(training, is_apart, strict=True))
    return [clip for clip, is_out in parts if not is_out], [clip for clip, is_out in parts if is_out]


def _is_last(config: TrainVerbsConfig, clips: Sequence[Clip]) -> list[bool]:
    """Return which clips are of the last sequences, or of a single one the last clips."""
    names, numbers = [one.recording for one, _ in clips], [one.number for one, _ in clips]
    rows = pa.table({"sequence_id": names, "frame": numbers})
    takes = rows.group_by("sequence_id").aggregate([("frame", "min")]) if len(set(names)) > 1 else rows
    is_apart = is_held_out(rows, takes.rename_columns(["sequence_id", "first_frame"]), config.held_out_share)
    return [bool(is_out) for is_out in is_apart.to_pylist()]


def _sequence(config: TrainVerbsConfig, clips: pa.Table) -> PoseSequenceConfig:
    """Return how clips become the network's input."""
    found = clips.group_by(["rate_hz", "graph"]).aggregate([]).to_pylist()
    kinds = sorted((row["rate_hz"], row["graph"]) for row in found)
    if len(kinds) > 1:
        raise ValueError(f"clips differ in rate and graph ({kinds}): cut all of them anew with equal parameters")
    ((rate_hz, graph),) = kinds
    return PoseSequenceConfig(rate_hz, 0, config.num_frames, config.length, config.centre, config.scale, graph)


def _clips(
    config: TrainVerbsConfig,
    given: Sequence[Clip],
    nouns: tuple[str, ...],
    sequence: PoseSequenceConfig,
    augmentation: VerbAugmentation,
) -> VerbClips:
    clips = VerbClips.of(
        [clip for _, clip in given],
        [(segment.verb, segment.noun) for segment, _ in given],
        config.verbs,
        nouns,
        sequence,
        augmentation,
        config.seed,
        {} if augmentation is PLAIN else config.oversampling,
    )
    return clips if config.labels == "true" else clips.shuffled(config.seed)


STAGE = Stage(
    name="train_verbs",
    version=2,
    config=TrainVerbsConfig,
    inputs={"members": MEMBERS, "clips": VERB_CLIPS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="set",
    uses_gpu=True,
    externals=training_externals,
)
