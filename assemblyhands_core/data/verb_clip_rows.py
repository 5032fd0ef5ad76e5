"""Clips of poses as rows of the table `verb_tables.VERB_CLIPS`, and the poses of a table of joints as tracks."""

from typing import Any, Final

import numpy as np
import pyarrow as pa

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.pose_clips import PoseClip, PoseTracks
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.hands.graphs import GraphName
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS

_SAID: Final = ("verb", "noun", "first_key", "last_key")


def tracks_of_joints(
    joints: pa.Table, num_frames: int, keys_per_frame: int, first_key: int, graph: GraphName
) -> PoseTracks:
    """Return the poses of a table of joints over time, from the video's first frame to its last one.

    They begin and end with the video whatever is known there, so that clips of all sources have the same instants.

    Args:
        joints: `catalog.JOINTS` of one sequence and one round.
        num_frames: Of the video.
        keys_per_frame: 60 Hz keys between two frames.
        first_key: Key of frame 0.
        graph: Which nodes the tracks are to have.

    Raises:
        ValueError: A hand has joints of several rounds at a frame.
    """
    if joints.group_by(["frame", "hand"]).aggregate([]).num_rows < joints.num_rows:
        rounds = sorted(set(joints["round"].to_pylist()))
        raise ValueError(f"joints of rounds {rounds} stand beside each other; give those of one round.")
    known = to_numpy(joints["frame"])
    frames = np.unique(np.concatenate(([0, num_frames - 1], known)))
    both = np.full((len(frames), len(HANDS), NUM_JOINTS, 3), np.nan)
    hands = np.array([HANDS.index(hand) for hand in joints["hand"].to_pylist()], dtype=np.int64)
    both[np.searchsorted(frames, known), hands] = joints_or_nan(joints)
    points = both.reshape(-1, NUM_BOTH, 3)
    times_s = (first_key + keys_per_frame * frames.astype(np.float64)) / KEY_RATE_HZ
    return PoseTracks.of(points, np.asarray(np.isfinite(points).all(axis=-1)), times_s, graph)


def clip_rows(segment: VerbSegment, clip: PoseClip, rate_hz: int) -> list[dict[str, Any]]:
    """Return a segment's clip as rows, one for each instant."""
    names = {
        "sequence_id": segment.recording,
        "segment": segment.number,
        "verb": segment.verb,
        "noun": segment.noun,
        "first_key": segment.first_key,
        "last_key": segment.last_key,
        "rate_hz": rate_hz,
        "graph": clip.graph,
    }
    columns = zip(clip.nodes_mm, clip.observed, clip.is_interpolated, strict=True)
    return [
        {**names, "instant": instant, "nodes_mm": nodes.ravel(), "observed": observed, "is_interpolated": between}
        for instant, (nodes, observed, between) in enumerate(columns)
    ]


def clips_of(table: pa.Table) -> list[tuple[VerbSegment, PoseClip]]:
    """Return segments with their clips by sequence and number, whatever the order of a table's rows."""
    table = table.sort_by([(name, "ascending") for name in VERB_CLIPS.key])
    starts = np.flatnonzero(to_numpy(table["instant"]) == 0)
    columns = (np.split(to_numpy(table[name]), starts)[1:] for name in ("nodes_mm", "observed", "is_interpolated"))
    return [
        (
            VerbSegment(row["sequence_id"], row["segment"], *(row[name] for name in _SAID)),
            PoseClip(nodes.reshape(-1, len(HANDS), NUM_JOINTS, 3), observed, between, row["graph"]),
        )
        for row, nodes, observed, between in zip(
            table.select([*VERB_CLIPS.key, *_SAID, "graph"]).take(starts).to_pylist(), *columns, strict=True
        )
    ]
