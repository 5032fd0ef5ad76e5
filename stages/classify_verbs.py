"""Tell from clips of hand poses which verb is done, with a frozen MS-G3D (paper, Sec. 5)."""

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from pydantic import Field

from assemblyhands_core.data.fine_grained import VERBS
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import WRIST_NODE
from assemblyhands_core.data.training_tables import WEIGHTS
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS, VERB_PREDICTIONS
from stages._contract import Context, Stage, StageConfig, Tables
from stages._training import weights_file


class ClassifyVerbsConfig(StageConfig):
    """Parameters of classification; noise serves to see what worse poses cost."""

    batch_size: int = Field(ge=1)
    noise_mm: float = Field(ge=0)
    noise_seed: int = Field(ge=0)


def run(config: ClassifyVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Classify the segments of one sequence; where no pose was seen, or no network was trained, is no prediction.

    Raises:
        ValueError: The network was trained for clips of another rate or graph, or its file does not say for what.
    """
    if not inputs["weights"].num_rows:
        return {"predictions": VERB_PREDICTIONS.empty()}
    given = clips_of(inputs["clips"])
    segments = [segment for segment, _ in given]
    clips = [_noisy(clip, config, f"{one.recording} {one.number}") for one, clip in given]
    reference = {segment.number: clip for segment, clip in clips_of(inputs["reference"])}
    probability, verbs = _probabilities(config, inputs, segments, clips, context)
    found = []
    for segment, clip, values in zip(segments, clips, probability, strict=True):
        is_seen = bool(np.isfinite(values).all())
        found.append(
            {
                "sequence_id": segment.recording,
                "segment": segment.number,
                "verb": segment.verb,
                "first_key": segment.first_key,
                "predicted": verbs[int(values.argmax())] if is_seen else "",
                "confidence": values.max() if is_seen else np.nan,
                "probability": _of_all_verbs(values, verbs),
                "pose_error_mm": wrist_relative_error_mm(clip, reference.get(segment.number)),
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


def _of_all_verbs(values: npt.NDArray[np.float32], verbs: tuple[str, ...]) -> npt.NDArray[np.float32]:
    """Return the probabilities of Assembly101's verbs: 0 of those that are no class, NaN of all without prediction."""
    found = np.where(np.isfinite(values).all(), np.zeros(len(VERBS), dtype=np.float32), np.float32(np.nan))
    found[[VERBS.index(verb) for verb in verbs]] = values
    return found


def _noisy(clip: PoseClip, config: ClassifyVerbsConfig, name: str) -> PoseClip:
    """Return a clip with noise of its own on every node, which no order of work changes."""
    if config.noise_mm == 0:
        return clip
    rng = np.random.default_rng([config.noise_seed, zlib.crc32(name.encode())])
    noise = config.noise_mm * rng.normal(size=clip.nodes_mm.shape)
    return replace(clip, nodes_mm=(clip.nodes_mm + noise).astype(np.float32))


def _probabilities(
    config: ClassifyVerbsConfig,
    inputs: Tables,
    segments: Sequence[VerbSegment],
    clips: Sequence[PoseClip],
    context: Context,
) -> tuple[npt.NDArray[np.float32], tuple[str, ...]]:
    """Return the probabilities (clip, verb), NaN where nothing was seen, and the verbs."""
    # Importing torch takes seconds, which every command would pay at the head of this file.
    from assemblyhands_core.models.verb_classification import VerbClassifier
    from assemblyhands_core.models.warm import load_once

    classifier = load_once(VerbClassifier.load, weights_file(inputs["weights"]))
    wanted_hz = classifier.sequence.rate_hz
    if other := set(inputs["clips"]["rate_hz"].unique().to_pylist()) - {wanted_hz}:
        raise ValueError(f"the network takes clips of {wanted_hz} Hz, these are of {other.pop()} Hz: cut them anew.")
    found = np.full((len(clips), len(classifier.verbs)), np.nan, dtype=np.float32)
    seen = [index for index, clip in enumerate(clips) if clip.observed.any()]
    if seen:
        chosen, told = [clips[index] for index in seen], [segments[index].noun for index in seen]
        found[seen] = classifier.probabilities(chosen, told, config.batch_size, context.num_threads)
    return found, classifier.verbs


STAGE = Stage(
    name="classify_verbs",
    version=2,
    config=ClassifyVerbsConfig,
    inputs={"clips": VERB_CLIPS, "reference": VERB_CLIPS, "weights": WEIGHTS},
    outputs={"predictions": VERB_PREDICTIONS},
    run=run,
    shard="sequence",
    uses_gpu=True,
)
