"""Tell from clips of hand poses which verb is done, with a frozen MS-G3D (paper, Sec. 5)."""

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt
from pydantic import Field

from assemblyhands_core.data.catalog import WEIGHTS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import WRIST_NODE
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_tables import VERB_CLIPS, VERB_PREDICTIONS
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import weights_file

_NAMES: Final = ["sequence_id", "segment", "verb", "first_key"]


class ClassifyVerbsConfig(StageConfig):
    """Parameters of classification; noise serves to see what worse poses cost."""

    batch_size: int = Field(ge=1)
    noise_mm: float = Field(ge=0)
    noise_seed: int = Field(ge=0)


def run(config: ClassifyVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Classify the segments of one sequence; where no pose was seen there is no prediction.

    Raises:
        ValueError: The network was trained for clips of another rate or graph, or its file does not say for what.
    """
    rows = inputs["clips"].select(_NAMES).to_pylist()
    reference = dict(zip(inputs["reference"]["segment"].to_pylist(), clips_of(inputs["reference"]), strict=True))
    pairs = zip(rows, clips_of(inputs["clips"]), strict=True)
    clips = [_noisy(clip, config, f"{row['sequence_id']} {row['segment']}") for row, clip in pairs]
    probability, verbs = _probabilities(config, inputs, clips, context)
    found = []
    for row, clip, values in zip(rows, clips, probability, strict=True):
        is_seen = bool(np.isfinite(values).all())
        found.append(
            {
                **row,
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
    config: ClassifyVerbsConfig, inputs: Tables, clips: Sequence[PoseClip], context: Context
) -> tuple[npt.NDArray[np.float32], tuple[str, ...]]:
    """Return the probabilities (clip, verb), NaN where nothing was seen, and the verbs."""
    # Importing torch takes seconds, which every command would pay at the head of this file.
    from assemblyhands_core.models.verb_classification import VerbClassifier

    classifier, nouns = VerbClassifier.load(weights_file(inputs["weights"])), inputs["clips"]["noun"].to_pylist()
    wanted_hz = classifier.sequence.rate_hz
    if other := set(inputs["clips"]["rate_hz"].to_pylist()) - {wanted_hz}:
        raise ValueError(f"the network takes clips of {wanted_hz} Hz, these are of {other.pop()} Hz: cut them anew.")
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
