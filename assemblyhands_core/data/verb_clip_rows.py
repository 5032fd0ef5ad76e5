"""Clips of poses as rows of the table `verb_tables.VERB_CLIPS`, and the poses of a table of joints as tracks."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.data.pose_clips import PoseClip, PoseTracks
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.verb_segments import VerbSegment
from assemblyhands_core.hands.graphs import GraphName
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS


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


def clips_of(table: pa.Table) -> list[PoseClip]:
    """Return the clips of a table, in the order of its rows; their arrays are views of its columns."""
    shape = -1, len(HANDS)
    columns = (_values(table[name]) for name in ("nodes_mm", "observed", "is_interpolated"))
    return [
        PoseClip(nodes.reshape(*shape, NUM_JOINTS, 3), observed.reshape(shape), between.reshape(shape), graph)
        for nodes, observed, between, graph in zip(*columns, table["graph"].to_pylist(), strict=True)
    ]


def _values(column: pa.ChunkedArray) -> list[npt.NDArray[Any]]:
    """Return each row's values; by way of Python's numbers a training set would take gigabytes."""
    lists = column.combine_chunks()
    lengths, values = to_numpy(pc.list_value_length(lists)), to_numpy(lists.flatten())
    ends = np.cumsum(lengths, dtype=np.int64)
    return [values[first:end] for first, end in zip(ends - lengths, ends, strict=True)]
