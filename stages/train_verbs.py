"""Train MS-G3D to tell verbs from clips of hand poses of one source, in the training sequences (paper, Sec. 5)."""

from typing import Literal

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import MEMBERS, TRAINING_CURVE, WEIGHTS
from assemblyhands_core.data.pose_sequences import Centre, Length, PoseSequenceConfig, Scale
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.training.verb_dataset import PLAIN, Mirroring, VerbAugmentation, VerbClips
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import ScheduleConfig, fitted, is_held_out, started, training_externals

TRAINING_SPLITS = ("train", "manual_train")
_VALIDATION_SPLITS = ("val", "manual_val")


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


def run(config: TrainVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Train on the clips of the training sequences.

    Raises:
        ValueError: There are none with poses, or clips differ in their graph or rate.
    """
    import torch

    from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
    from assemblyhands_core.models.verb_classification import VerbClassifier
    from assemblyhands_core.training.tasks import verb_task

    torch.manual_seed(config.seed)
    training, held_out = _split(config, inputs)
    sequence = _sequence(config, pa.concat_tables([training, held_out]))
    nouns = tuple(sorted(set(training["noun"].to_pylist()))) if config.object_cue else ()
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
    card = {"start": start, **VerbClassifier.card(config.verbs, nouns, sequence)}
    return fitted(network, task, config, context, card, "percent")


def _split(config: TrainVerbsConfig, inputs: Tables) -> tuple[pa.Table, pa.Table]:
    """Return what is learnt from and what is held out: sequences of split `val`, else the last ones for training.

    Where there is a single one, it is its last segments. Segments in which no hand was seen are in neither.
    """
    members, clips = inputs["members"], inputs["clips"]
    clips = clips.filter(pa.array([bool(clip.observed.any()) for clip in clips_of(clips)], pa.bool_()))
    training, held_out = (_of_splits(clips, members, splits) for splits in (TRAINING_SPLITS, _VALIDATION_SPLITS))
    if not training.num_rows:
        raise ValueError("no sequence of split train has poses in segments with verbs: add some")
    if held_out.num_rows:
        return training, held_out
    rows = training.append_column("frame", training["segment"])
    names = ["sequence_id", "segment"] if pc.count_distinct(rows["sequence_id"]).as_py() == 1 else ["sequence_id"]
    takes = rows.group_by(names).aggregate([("segment", "min")]).rename_columns([*names, "first_frame"])
    is_apart = is_held_out(rows, takes, config.held_out_share)
    return training.filter(pc.invert(is_apart)), training.filter(is_apart)


def _of_splits(clips: pa.Table, members: pa.Table, splits: tuple[str, ...]) -> pa.Table:
    names = members.filter(pc.is_in(members["split"], value_set=pa.array(splits)))["sequence_id"].combine_chunks()
    return clips.filter(pc.is_in(clips["sequence_id"], value_set=names))


def _sequence(config: TrainVerbsConfig, clips: pa.Table) -> PoseSequenceConfig:
    """Return how clips become the network's input."""
    kinds = {(row["rate_hz"], row["graph"]) for row in clips.select(["rate_hz", "graph"]).to_pylist()}
    if len(kinds) > 1:
        raise ValueError(
            f"clips differ in rate and graph ({sorted(kinds)}): cut all of them anew with equal parameters"
        )
    ((rate_hz, graph),) = kinds
    return PoseSequenceConfig(rate_hz, 0, config.num_frames, config.length, config.centre, config.scale, graph)


def _clips(
    config: TrainVerbsConfig,
    table: pa.Table,
    nouns: tuple[str, ...],
    sequence: PoseSequenceConfig,
    augmentation: VerbAugmentation,
) -> VerbClips:
    clips = VerbClips.of(
        clips_of(table),
        list(zip(table["verb"].to_pylist(), table["noun"].to_pylist(), strict=True)),
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
    version=1,
    config=TrainVerbsConfig,
    inputs={"members": MEMBERS, "clips": VERB_CLIPS},
    outputs={"weights": WEIGHTS, "curve": TRAINING_CURVE},
    run=run,
    shard="set",
    externals=training_externals,
)
