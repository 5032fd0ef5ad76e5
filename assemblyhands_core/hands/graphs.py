"""Graphs of a hand for graph convolutions: who is how many bones away from whom.

Two graphs of 21 nodes each: `skeleton` has our joints and their bones, thumb CMC and wrist included; `landmarks` is the
one that Assembly101's classifiers were trained on, with nodes in the order of its pose files, no thumb CMC, and a palm
centre that hangs on nothing. Source: Liu et al., MS-G3D (CVPR 2020), Sec. 3.1–3.2; Assembly101's landmarks.
"""

from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from assemblyhands_core.hands.joints import BONES, JOINT_NAMES, NUM_JOINTS, WRIST

GraphName = Literal["skeleton", "landmarks"]
Edges = tuple[tuple[int, int], ...]

UNREACHED: Final = -1
"""Distance between nodes that no path joins."""

# Tips from thumb to pinky, wrist, thumb MCP and IP, then from index to pinky each finger from base to tip.
_LANDMARK_NAMES: Final = (
    *("thumb_tip", "index_tip", "middle_tip", "ring_tip", "pinky_tip", "wrist", "thumb_mcp", "thumb_ip"),
    *(f"{finger}_{end}" for finger in ("index", "middle", "ring", "pinky") for end in ("mcp", "pip", "dip")),
)
JOINT_OF_LANDMARK: Final = tuple(JOINT_NAMES.index(name) for name in _LANDMARK_NAMES)
"""Our index of each Assembly101 landmark but the last one, the palm centre."""

_PALM_JOINTS: Final = (*(JOINT_NAMES.index(f"{finger}_mcp") for finger in ("index", "middle", "ring", "pinky")), WRIST)
_LANDMARK_EDGES: Final = (
    *((5, 6), (6, 7), (7, 0)),
    *((5, 8), (8, 9), (9, 10), (10, 1)),
    *((5, 11), (11, 12), (12, 13), (13, 2)),
    *((5, 14), (14, 15), (15, 16), (16, 3)),
    *((5, 17), (17, 18), (18, 19), (19, 4)),
    *((6, 8), (8, 11), (11, 14), (14, 17)),
)
EDGES: Final[dict[GraphName, Edges]] = {"skeleton": BONES, "landmarks": _LANDMARK_EDGES}


def graph_nodes(joints: Float[np.ndarray, "*any 21 3"], graph: GraphName) -> Float[np.ndarray, "*any 21 3"]:
    """Return the positions of a graph's nodes.

    Args:
        joints: One hand in our order, in any frame and unit; NaN where unknown, which makes what needs it NaN.
        graph: `skeleton` takes the joints as they are; `landmarks` leaves the thumb CMC out and adds the palm centre,
            the mean of the wrist and the four fingers' MCPs.
    """
    if graph == "skeleton":
        return joints
    palm = joints[..., _PALM_JOINTS, :].mean(axis=-2, keepdims=True)
    return np.concatenate((joints[..., JOINT_OF_LANDMARK, :], palm), axis=-2)


def adjacency(edges: Edges, num_nodes: int = NUM_JOINTS) -> Bool[np.ndarray, "node node"]:
    """Return which nodes an edge joins, in both directions; no node is its own neighbour."""
    is_joined = np.zeros((num_nodes, num_nodes), dtype=bool)
    is_joined[tuple(np.transpose(edges))] = True
    return np.logical_or(is_joined, is_joined.T)


def window_adjacency(is_joined: Bool[np.ndarray, "node node"], num_frames: int) -> Bool[np.ndarray, "copy copy"]:
    """Return the adjacency of a graph's copies in several frames, frame by frame.

    A node is joined to its neighbours and to itself in all frames of the window, its own one included.
    Source: MS-G3D, Sec. 3.3.
    """
    return np.tile(is_joined | np.eye(len(is_joined), dtype=bool), (num_frames, num_frames))


def hop_distances(is_joined: Bool[np.ndarray, "node node"]) -> Int[np.ndarray, "node node"]:
    """Return the number of edges on the shortest path between all nodes; `UNREACHED` where there is none."""
    is_reached = np.eye(len(is_joined), dtype=bool)
    distances = np.where(is_reached, 0, UNREACHED)
    for hops in range(1, len(is_joined)):
        is_new = (is_reached @ is_joined) & ~is_reached
        distances[is_new] = hops
        is_reached |= is_new
    return distances


def k_adjacency(distances: Int[np.ndarray, "node node"], k: int, with_self: bool) -> Float[np.ndarray, "node node"]:
    """Return 1 where nodes are exactly k edges apart, else 0; `with_self` adds the identity, if k is not 0 anyway.

    Beyond the graph's diameter nothing is left but that identity. Source: MS-G3D, Eq. 3.
    """
    is_self = with_self & np.eye(len(distances), dtype=bool)
    return np.asarray((distances == k) | is_self, dtype=np.float64)


def scale_matrices(is_joined: Bool[np.ndarray, "node node"], num_scales: int) -> Float[np.ndarray, "scale node node"]:
    """Return D^-1/2 A_k D^-1/2 of the k-adjacencies with self-loops, k = 0 … num_scales - 1.

    Source: MS-G3D, Eq. 4, where D is the diagonal matrix of the rows' sums.
    """
    distances = hop_distances(is_joined)
    matrices = np.stack([k_adjacency(distances, k, with_self=True) for k in range(num_scales)])
    degrees = matrices.sum(axis=-1)
    return np.asarray(matrices / np.sqrt(degrees[:, :, None] * degrees[:, None, :]))
