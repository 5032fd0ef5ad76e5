"""Graphs: a path and a square by hand, our skeleton, the landmarks of Assembly101, and the reference's matrices."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.hands.graphs import (
    EDGES,
    JOINT_OF_LANDMARK,
    UNREACHED,
    adjacency,
    graph_nodes,
    hop_distances,
    k_adjacency,
    scale_matrices,
    window_adjacency,
)
from assemblyhands_core.hands.joints import JOINT_NAMES, NUM_JOINTS

PATH = adjacency(((0, 1), (1, 2), (2, 3)), num_nodes=5)  # 0 – 1 – 2 – 3, and 4 alone


def test_distances_along_a_path() -> None:
    np.testing.assert_array_equal(
        hop_distances(PATH),
        [[0, 1, 2, 3, -1], [1, 0, 1, 2, -1], [2, 1, 0, 1, -1], [3, 2, 1, 0, -1], [-1, -1, -1, -1, 0]],
    )


def test_k_adjacency_of_a_path() -> None:
    two_apart = np.array([[0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [1, 0, 0, 0, 0], [0, 1, 0, 0, 0], [0, 0, 0, 0, 0]])
    distances = hop_distances(PATH)
    np.testing.assert_array_equal(k_adjacency(distances, 2, with_self=False), two_apart)
    np.testing.assert_array_equal(k_adjacency(distances, 2, with_self=True), two_apart + np.eye(5))
    for with_self in (False, True):
        np.testing.assert_array_equal(k_adjacency(distances, 0, with_self), np.eye(5))
    np.testing.assert_array_equal(k_adjacency(distances, 4, with_self=True), np.eye(5))


def test_scales_are_normalised_by_both_ends() -> None:
    """Of 0 – 1 – 2: the ends have two entries a row, the middle three."""
    end, side = 1 / 2, 1 / np.sqrt(6)
    one_apart = [[end, side, 0], [side, 1 / 3, side], [0, side, end]]
    two_apart = [[end, 0, end], [0, 1, 0], [end, 0, end]]
    matrices = scale_matrices(adjacency(((0, 1), (1, 2)), num_nodes=3), 5)
    np.testing.assert_allclose(matrices, [np.eye(3), one_apart, two_apart, np.eye(3), np.eye(3)], rtol=1e-15)


def test_a_window_joins_neighbours_and_oneself_in_all_frames() -> None:
    both = window_adjacency(adjacency(((0, 1),), num_nodes=3), num_frames=2)
    block = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]], dtype=bool)
    np.testing.assert_array_equal(both, np.block([[block, block], [block, block]]))
    distances = hop_distances(both)
    assert distances[0, 0] == 0 and distances[0, 3] == 1 and distances[0, 4] == 1 and distances[0, 5] == UNREACHED


@settings(max_examples=25, derandomize=True, deadline=None)
@given(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)).filter(lambda edge: edge[0] != edge[1]), min_size=1))
def test_each_pair_has_one_distance_and_rows_sum_by_definition(edges: set[tuple[int, int]]) -> None:
    is_joined = adjacency(tuple(edges), num_nodes=7)
    distances = hop_distances(is_joined)
    np.testing.assert_array_equal(distances, distances.T)
    np.testing.assert_array_equal(distances == 1, is_joined)
    is_near = sum(k_adjacency(distances, k, with_self=False) for k in range(7))
    np.testing.assert_array_equal(is_near, distances != UNREACHED)
    for k, matrix in enumerate(scale_matrices(is_joined, 8)):
        degree = ((distances == k) | np.eye(7, dtype=bool)).sum(axis=1)
        np.testing.assert_allclose(matrix @ np.sqrt(degree), np.sqrt(degree), rtol=1e-12)  # its first eigenvector


def test_our_skeleton_is_a_tree_that_spans_nine_joints() -> None:
    distances = hop_distances(adjacency(EDGES["skeleton"]))
    thumb_tip, thumb_cmc, pinky_tip = (JOINT_NAMES.index(name) for name in ("thumb_tip", "thumb_cmc", "pinky_tip"))
    assert len(EDGES["skeleton"]) == NUM_JOINTS - 1 and distances.min() == 0 and distances.max() == 8
    assert distances[thumb_tip, pinky_tip] == 8 and distances[thumb_tip, thumb_cmc] == 3


def test_landmarks_have_an_isolated_palm_and_tie_the_mcps_together() -> None:
    distances = hop_distances(adjacency(EDGES["landmarks"]))
    assert len(EDGES["landmarks"]) == 23 and distances.max() == 8
    assert (np.delete(distances[20], 20) == UNREACHED).all()
    assert distances[0, 5] == 3 and distances[1, 5] == 4 and distances[8, 17] == 2


def test_landmarks_are_the_published_mapping() -> None:
    assert JOINT_OF_LANDMARK == (0, 4, 8, 12, 16, 20, 2, 1, 7, 6, 5, 11, 10, 9, 15, 14, 13, 19, 18, 17)


def test_nodes_by_graph() -> None:
    joints = np.random.default_rng(0).normal(size=(2, 5, NUM_JOINTS, 3)).astype(np.float32)
    nodes = graph_nodes(joints, "landmarks")
    assert graph_nodes(joints, "skeleton") is joints and nodes.dtype == np.float32
    np.testing.assert_array_equal(nodes[..., 5, :], joints[..., 20, :])
    palm = (joints[..., 7, :] + joints[..., 11, :] + joints[..., 15, :] + joints[..., 19, :] + joints[..., 20, :]) / 5
    np.testing.assert_allclose(nodes[..., 20, :], palm, rtol=0, atol=1e-6)
    joints[0, 0, 3] = np.nan  # the thumb CMC, which has no landmark
    joints[0, 1, 7] = np.nan
    is_unknown = np.isnan(graph_nodes(joints, "landmarks")).any(axis=-1)
    assert not is_unknown[0, 0].any() and np.flatnonzero(is_unknown[0, 1]).tolist() == [8, 20]


def test_matrices_of_the_reference_program(golden_dir: Path) -> None:
    is_joined = adjacency(EDGES["landmarks"])
    distances = hop_distances(is_joined)
    with np.load(golden_dir / "msg3d.npz") as golden:
        assert {frozenset(edge) for edge in golden["edges_inward"].tolist()} == set(map(frozenset, EDGES["landmarks"]))
        np.testing.assert_array_equal(is_joined, golden["A_binary"])
        for k in range(14):
            np.testing.assert_array_equal(k_adjacency(distances, k, with_self=False), golden["k_adjacency"][k])
            np.testing.assert_array_equal(k_adjacency(distances, k, with_self=True), golden["k_adjacency_with_self"][k])
        np.testing.assert_allclose(scale_matrices(is_joined, 13).reshape(-1, 21), golden["gcn_A_powers_13"], atol=1e-6)


@pytest.mark.parametrize("num_frames", [3, 5])
def test_windows_of_the_reference_program(golden_dir: Path, num_frames: int) -> None:
    matrices = scale_matrices(window_adjacency(adjacency(EDGES["landmarks"]), num_frames), 6)
    with np.load(golden_dir / "msg3d.npz") as golden:
        expected = golden[f"g3d_A_scales_6_w{num_frames}"]
    np.testing.assert_allclose(matrices.reshape(expected.shape), expected, atol=1e-6)
