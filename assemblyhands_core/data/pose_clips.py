"""Two hands' poses over a stretch of time: on a regular time base, gaps filled and flagged.

Poses of a recording come at any rate and with holes (`PoseTracks`); a clip has an instant every 1 / rate seconds at
multiples of that step, so that 30 Hz instants meet the frames of a 30 Hz video. Between known frames nodes move in
straight lines; before the first and after the last known one they stay where they are. Nothing is looked at outside the
clip but the next frame on either side.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ
from assemblyhands_core.hands.graphs import EDGES, GraphName, adjacency, graph_nodes
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand

_MIN_KNOWN: Final = 0.5
"""The share of a hand's nodes that have to be known at a frame for the hand to count as observed there."""
_EPSILON: Final = 1e-6  # of a frame: instants this near to a frame are the frame, so that rounding changes nothing


@dataclass(frozen=True, eq=False)
class PoseTracks:
    """The poses of a recording, in the order of hands and nodes that a network takes.

    Attributes:
        nodes_mm: In one frame of reference; NaN where missing.
        times_s: When each frame was; key 0 of 60 Hz is at 0 s. Rising; frames may be missing.
        graph: What the nodes are.
    """

    nodes_mm: Float[np.ndarray, "frame hand=2 node=21 xyz=3"]
    times_s: Float64[np.ndarray, " frame"]
    graph: GraphName

    def __post_init__(self) -> None:
        """Refuse times that do not rise."""
        if (np.diff(self.times_s) <= 0).any() or not np.isfinite(self.times_s).all():
            frame = int(np.argmin(np.diff(self.times_s, prepend=-np.inf) > 0))
            raise ValueError(
                f"frame {frame} of {len(self.times_s)} is at {self.times_s[frame]} s, not after the one before it; "
                "sort the frames by time and give each once."
            )

    @staticmethod
    def of(
        joints_mm: Float[np.ndarray, "frame joint=42 xyz=3"],
        valid: Bool[np.ndarray, "frame joint=42"],
        times_s: Float64[np.ndarray, " frame"],
        graph: GraphName,
        hands: tuple[Hand, Hand] = HANDS,
    ) -> "PoseTracks":
        """Take joints in our order, right hand first.

        Args:
            joints_mm: Of both hands.
            valid: Which of them are known.
            times_s: When each frame was.
            graph: The nodes that are wanted.
            hands: The order of hands that is wanted.
        """
        known = np.where(valid[..., None], joints_mm, np.nan).reshape(-1, len(HANDS), NUM_JOINTS, 3)
        ordered = known[:, [HANDS.index(hand) for hand in hands]]
        return PoseTracks(graph_nodes(ordered, graph), times_s, graph)


@dataclass(frozen=True, eq=False)
class PoseClip:
    """Poses at regular instants.

    Attributes:
        nodes_mm: NaN for a hand that is never observed, complete for any other.
        observed: Where the hand was measured, at most half a step away.
        is_interpolated: Where it was not, but was put between or beside instants at which it was.
        graph: What the nodes are.
    """

    nodes_mm: Float32[np.ndarray, "instant hand=2 node=21 xyz=3"]
    observed: Bool[np.ndarray, "instant hand=2"]
    is_interpolated: Bool[np.ndarray, "instant hand=2"]
    graph: GraphName

    def __len__(self) -> int:
        """Return the number of instants."""
        return len(self.nodes_mm)

    @property
    def coverage(self) -> float:
        """The share of instants and hands that were observed; 0 of an empty clip."""
        return float(self.observed.mean()) if len(self) else 0.0

    @property
    def is_present(self) -> Bool[np.ndarray, "instant hand=2"]:
        """Where there is a pose, observed or not."""
        return np.asarray(self.observed | self.is_interpolated)

    def at(self, places: Float64[np.ndarray, " place"]) -> "PoseClip":
        """Return the poses at places between instants, 0 for the first one; flags are those of the nearest instant."""
        nearest = np.rint(places).astype(np.int64)
        nodes = _between(self.nodes_mm, places).astype(np.float32)
        return PoseClip(nodes, self.observed[nearest], self.is_interpolated[nearest], self.graph)


def cut_clip(tracks: PoseTracks, first_key: int, last_key: int, rate_hz: int, context_keys: int = 0) -> PoseClip:
    """Cut a stretch out of a recording.

    Args:
        tracks: The recording's poses.
        first_key: First 60 Hz frame.
        last_key: Last 60 Hz frame, which belongs to it.
        rate_hz: Of the clip's instants.
        context_keys: How many 60 Hz frames are added on both sides, as far as the recording goes.

    Returns:
        The clip; without instants if the recording ended before or began later.
    """
    start_s, end_s = (first_key - context_keys) / KEY_RATE_HZ, (last_key + context_keys) / KEY_RATE_HZ
    at_s = _instants(tracks.times_s, start_s, end_s, rate_hz)
    near = slice(0)
    if len(at_s):
        reach_s = max(0.5 / rate_hz, float(np.ptp(tracks.times_s)) / max(len(tracks.times_s) - 1, 1))
        bounds = at_s[[0, -1]] + [-reach_s - _EPSILON, reach_s + _EPSILON]
        near = slice(*np.searchsorted(tracks.times_s, bounds).tolist())
    times_s, nodes = tracks.times_s[near], tracks.nodes_mm[near].astype(np.float64)
    is_known = np.asarray(np.isfinite(nodes).all(axis=-1))
    observed = np.stack([_observed(is_known[:, hand], times_s, at_s, rate_hz) for hand in range(2)], axis=1)
    found = np.full((len(at_s), *nodes.shape[1:]), np.nan)
    for hand in np.flatnonzero(observed.any(axis=0)):
        moved = _interpolated(nodes[:, hand], is_known[:, hand], times_s, at_s)
        found[:, hand] = _with_unknown_nodes(moved, tracks.graph)
    is_interpolated = observed.any(axis=0) & ~observed
    return PoseClip(found.astype(np.float32), observed, is_interpolated, tracks.graph)


def _instants(
    times_s: Float64[np.ndarray, " frame"], start_s: float, end_s: float, rate_hz: int
) -> Float64[np.ndarray, " instant"]:
    """Return the multiples of the step from start to end, both included, within the recording."""
    if not len(times_s) or start_s > times_s[-1] + _EPSILON or end_s < times_s[0] - _EPSILON:
        return np.zeros(0)
    first = int(np.ceil(max(start_s, times_s[0]) * rate_hz - _EPSILON))
    last = int(np.floor(min(end_s, times_s[-1]) * rate_hz + _EPSILON))
    if last < first:  # shorter than a step, and between two instants: the later one
        last = first
    return np.arange(first, last + 1) / rate_hz


def _observed(
    is_known: Bool[np.ndarray, "frame node"],
    times_s: Float64[np.ndarray, " frame"],
    at_s: Float64[np.ndarray, " instant"],
    rate_hz: int,
) -> Bool[np.ndarray, " instant"]:
    """Return the instants that a frame in which the hand is known is at most half a step away from."""
    known_s = times_s[is_known.mean(axis=1) >= _MIN_KNOWN]
    if not len(known_s):
        return np.zeros(len(at_s), dtype=bool)
    after = np.searchsorted(known_s, at_s).clip(1, max(len(known_s) - 1, 1))
    before_s, after_s = known_s[after - 1], known_s[np.minimum(after, len(known_s) - 1)]
    gap_s = np.minimum(np.abs(at_s - before_s), np.abs(at_s - after_s))
    return np.asarray(gap_s * rate_hz <= 0.5 + _EPSILON)


def _interpolated(
    nodes: Float64[np.ndarray, "frame node xyz"],
    is_known: Bool[np.ndarray, "frame node"],
    times_s: Float64[np.ndarray, " frame"],
    at_s: Float64[np.ndarray, " instant"],
) -> Float64[np.ndarray, "instant node xyz"]:
    """Return the nodes at some instants, each from the frames in which it is known; NaN if there are none."""
    found = np.full((len(at_s), *nodes.shape[1:]), np.nan)
    patterns: dict[bytes, list[int]] = {}  # mostly one: a frame has all nodes of a hand or none
    for node, is_frame in enumerate(is_known.T):
        patterns.setdefault(is_frame.tobytes(), []).append(node)
    for chosen in patterns.values():
        is_frame = is_known[:, chosen[0]]
        if is_frame.any():
            places = np.interp(at_s, times_s[is_frame], np.arange(is_frame.sum()))
            found[:, chosen] = _between(nodes[is_frame][:, chosen], places)
    return found


def _between(
    values: Float[np.ndarray, "instant *node xyz"], places: Float64[np.ndarray, " place"]
) -> Float[np.ndarray, "place *node xyz"]:
    """Return values at places between frames; at a frame exactly its own."""
    nearest = np.rint(places)
    places = np.where(np.abs(places - nearest) < _EPSILON, nearest, places)
    before: Int[np.ndarray, " place"] = np.floor(places).astype(np.int64)
    after = np.minimum(before + 1, len(values) - 1)
    share = (places - before).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[before] + share * (values[after] - values[before]))


def _with_unknown_nodes(
    nodes: Float64[np.ndarray, "instant node=21 xyz"], graph: GraphName
) -> Float64[np.ndarray, "instant node=21 xyz"]:
    """Put nodes that are never known between their neighbours in the graph, or amid the hand where it has none."""
    unknown = np.isnan(nodes).any(axis=(0, 2))
    is_joined, filled = adjacency(EDGES[graph]), nodes.copy()
    for node in np.flatnonzero(unknown):
        beside = is_joined[node] & ~unknown
        filled[:, node] = nodes[:, beside if beside.any() else ~unknown].mean(axis=1)
    return filled
