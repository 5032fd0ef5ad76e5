"""Clips of poses as rows of the table `verb_tables.VERB_CLIPS`, and the poses of a table of joints as tracks."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.pose_clips import PoseClip, PoseTracks
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.hands.graphs import GraphName
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS


def tracks_of_joints(joints: pa.Table, keys_per_frame: int, first_key: int, graph: GraphName) -> PoseTracks:
    """Return the poses of a table of joints over time.

    Args:
        joints: `catalog.JOINTS` of one sequence and one round.
        keys_per_frame: 60 Hz keys between two frames.
        first_key: Key of frame 0.
        graph: Which nodes the tracks are to have.
    """
    frames, place = np.unique(to_numpy(joints["frame"]), return_inverse=True)
    both = np.full((len(frames), len(HANDS), NUM_JOINTS, 3), np.nan)
    hands = [HANDS.index(hand) for hand in joints["hand"].to_pylist()]
    both[place, hands] = joints_or_nan(joints)
    points = both.reshape(-1, NUM_BOTH, 3)
    times_s = (first_key + keys_per_frame * frames.astype(np.float64)) / KEY_RATE_HZ
    return PoseTracks.of(points, np.asarray(np.isfinite(points).all(axis=-1)), times_s, graph)


def clip_row(sequence_id: str, segment: VerbSegment, clip: PoseClip, rate_hz: int) -> dict[str, Any]:
    """Return a segment's clip as a row."""
    return {
        "sequence_id": sequence_id,
        "segment": segment.number,
        "verb": segment.verb,
        "noun": segment.noun,
        "first_key": segment.first_key,
        "last_key": segment.last_key,
        "rate_hz": rate_hz,
        "graph": clip.graph,
        "nodes_mm": clip.nodes_mm.ravel(),
        "observed": clip.observed.ravel(),
        "is_interpolated": clip.is_interpolated.ravel(),
    }


def clip_of_row(row: Mapping[str, Any]) -> PoseClip:
    """Return the clip of a row."""
    shape = -1, len(HANDS)
    return PoseClip(
        np.asarray(row["nodes_mm"], dtype=np.float32).reshape(*shape, NUM_JOINTS, 3),
        np.asarray(row["observed"], dtype=bool).reshape(shape),
        np.asarray(row["is_interpolated"], dtype=bool).reshape(shape),
        row["graph"],
    )
