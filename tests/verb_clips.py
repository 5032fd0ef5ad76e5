"""Small sets of clips of two hands whose verb shows in the direction in which they move."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.verb_clip_rows import clip_rows
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.hands.graphs import GraphName

VERBS = ("pick up", "screw", "remove")
NUM_INSTANTS = 16
_SHAPE = np.random.default_rng(0).normal(0, 30, (2, 21, 3))


def moving_clip(verb: str, number: int, graph: GraphName = "skeleton") -> PoseClip:
    """Hands, each a little different, that move by 120 mm along the axis of their verb's place; all is observed."""
    shape = _SHAPE + np.random.default_rng([1, number]).normal(0, 2, _SHAPE.shape)
    nodes = np.tile(shape, (NUM_INSTANTS, 1, 1, 1))
    nodes[..., VERBS.index(verb)] += np.linspace(-60, 60, NUM_INSTANTS)[:, None, None]
    observed = np.ones((NUM_INSTANTS, 2), dtype=bool)
    return PoseClip(nodes.astype(np.float32), observed, ~observed, graph)


def unseen_clip() -> PoseClip:
    """Hands that nobody saw."""
    never = np.zeros((NUM_INSTANTS, 2), dtype=bool)
    return PoseClip(np.full((NUM_INSTANTS, 2, 21, 3), np.nan, dtype=np.float32), never, never, "skeleton")


def clip_table(
    sequence_id: str, verbs: Sequence[str], clips: Sequence[PoseClip], nouns: Sequence[str] = (), rate_hz: int = 30
) -> pa.Table:
    """Return clips as a sequence's segments, numbered from 0; without nouns all are done with a bolt."""
    return VERB_CLIPS.from_rows(
        [
            row
            for i, (verb, clip, noun) in enumerate(zip(verbs, clips, nouns or ["bolt"] * len(verbs), strict=True))
            for row in clip_rows(VerbSegment(sequence_id, i, verb, noun, 100 * i, 100 * i + 31), clip, rate_hz)
        ]
    )


def moving_table(sequence_id: str, count: int, first: int = 0, rate_hz: int = 30) -> pa.Table:
    """Return so many clips of all verbs in turn; no two numbers give the same hands."""
    verbs = [VERBS[number % len(VERBS)] for number in range(count)]
    clips = [moving_clip(verb, first + number) for number, verb in enumerate(verbs)]
    return clip_table(sequence_id, verbs, clips, rate_hz=rate_hz)
