"""Tell from clips of hand poses which verb is done, with a frozen MS-G3D (paper, Sec. 5)."""

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pydantic import Field

from assemblyhands_core.data.catalog import WEIGHTS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import WRIST_NODE
from assemblyhands_core.data.verb_clip_rows import clip_of_row
from assemblyhands_core.data.verb_tables import VERB_CLIPS, VERB_PREDICTIONS
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import weights_file


class ClassifyVerbsConfig(StageConfig):
    """Parameters of classification; noise serves to see what worse poses cost."""

    batch_size: int = Field(ge=1)
    noise_mm: float = Field(ge=0)
    noise_seed: int = Field(ge=0)


def run(config: ClassifyVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Classify the segments of one sequence; where no pose was seen there is no prediction."""
    rows = inputs["clips"].to_pylist()
    reference = {row["segment"]: clip_of_row(row) for row in inputs["reference"].to_pylist()}
    clips = [_noisy(clip_of_row(row), config, f"{row['sequence_id']} {row['segment']}") for row in rows]
    nouns = [row["noun"] for row in rows]
    probability, verbs = _probabilities(config, inputs, clips, nouns, context)
    found = []
    for row, clip, values in zip(rows, clips, probability, strict=True):
        is_seen = bool(np.isfinite(values).all())
        found.append(
            {
                **{name: row[name] for name in ("sequence_id", "segment", "verb", "first_key")},
                "predicted": verbs[int(values.argmax())] if is_seen else "",
                "confidence": values.max() if is_seen else np.nan,
                "probability": values,
                "pose_error_mm": wrist_relative_error_mm(clip, reference.get(row["segment"])),
                "coverage": 100 * clip.coverage,
            }
        )
    return {"predictions": VERB_PREDICTIONS.from_rows(found)}


def wrist_relative_error_mm(clip: PoseClip, reference: PoseClip | None) -> float:
    """Return the mean distance of nodes, wrists at the origin, where both clips observed a hand; NaN without any."""
    if reference is None or len(clip) != len(reference) or clip.graph != reference.graph:
        return float("nan")
    is_common = clip.observed & reference.observed
    if not is_common.any():
        return float("nan")
    wrist = WRIST_NODE[clip.graph]
    one, other = (poses.nodes_mm[is_common].astype(np.float64) for poses in (clip, reference))
    return float(np.linalg.norm((one - one[:, wrist, None]) - (other - other[:, wrist, None]), axis=-1).mean())


def _noisy(clip: PoseClip, config: ClassifyVerbsConfig, name: str) -> PoseClip:
    """Return a clip with noise of its own on every node, which no order of work changes."""
    if config.noise_mm == 0:
        return clip
    rng = np.random.default_rng([config.noise_seed, zlib.crc32(name.encode())])
    noise = config.noise_mm * rng.normal(size=clip.nodes_mm.shape)
    return replace(clip, nodes_mm=(clip.nodes_mm + noise).astype(np.float32))


def _probabilities(
    config: ClassifyVerbsConfig, inputs: Tables, clips: Sequence[PoseClip], nouns: Sequence[str], context: Context
) -> tuple[npt.NDArray[np.float32], tuple[str, ...]]:
    """Return the probabilities (clip, verb), NaN where nothing was seen, and the verbs."""
    # Importing torch takes seconds, which every command would pay at the head of this file.
    from assemblyhands_core.models.verb_classification import VerbClassifier

    classifier = VerbClassifier.load(weights_file(inputs["weights"]))
    found = np.full((len(clips), len(classifier.verbs)), np.nan, dtype=np.float32)
    seen = [index for index, clip in enumerate(clips) if clip.observed.any()]
    if seen:
        chosen, told = [clips[index] for index in seen], [nouns[index] for index in seen]
        found[seen] = classifier.probabilities(chosen, told, config.batch_size, context.num_threads)
    return found, classifier.verbs


STAGE = Stage(
    name="classify_verbs",
    version=1,
    config=ClassifyVerbsConfig,
    inputs={"clips": VERB_CLIPS, "reference": VERB_CLIPS, "weights": WEIGHTS},
    outputs={"predictions": VERB_PREDICTIONS},
    run=run,
    shard="sequence",
)
