import numpy as np
import pytest

from assemblyhands_core.metrics.bootstrap import (
    BlockSums,
    block_sums,
    difference_interval,
    draw_weights,
    mean_interval,
    ratio_interval,
)


def _sums(values: np.ndarray) -> BlockSums:
    return BlockSums(values[:, None].astype(float), np.ones((len(values), 1)))


def test_rows_are_summed_by_block() -> None:
    sums = block_sums(np.array([[1.0], [2.0], [5.0]]), np.array([[True], [False], [True]]), np.array([0, 0, 2]), 3)
    assert sums.total.tolist() == [[3.0], [0.0], [5.0]] and sums.count.tolist() == [[1.0], [0.0], [1.0]]
    assert sums.mean().tolist() == [4.0]


def test_draws_are_as_many_as_there_are_blocks_and_the_seeds_own() -> None:
    weights = draw_weights(7, 50, seed=3)
    assert weights.shape == (50, 7) and np.all(weights.sum(axis=1) == 7)
    assert np.array_equal(weights, draw_weights(7, 50, seed=3)) and not np.array_equal(weights, draw_weights(7, 50, 4))


def test_the_interval_of_a_mean_has_the_width_that_theory_gives() -> None:
    values = np.random.default_rng(0).normal(10, 2, 400)
    found = mean_interval(_sums(values), draw_weights(400, 4000, 0))
    half = 1.96 * values.std() / np.sqrt(400)
    assert found.value[0] == pytest.approx(values.mean())
    assert found.low[0] == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high[0] == pytest.approx(values.mean() + half, abs=0.1 * half)


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    """300 worlds of 40 blocks with unequal counts; 95 % nominal, a binomial's 4 sigma and the small-sample loss off."""
    random, hits = np.random.default_rng(1), 0
    weights = draw_weights(40, 400, 0)
    for _ in range(300):
        count = random.integers(1, 30, 40).astype(float)
        level = random.normal(0, 2, 40)
        sums = BlockSums((count * (5 + level))[:, None] + random.normal(0, np.sqrt(count))[:, None], count[:, None])
        found = mean_interval(sums, weights)
        hits += bool(found.low[0] <= 5 <= found.high[0])
    assert 0.88 <= hits / 300 <= 0.99


def test_pairing_takes_out_what_is_hard_for_both() -> None:
    random = np.random.default_rng(2)
    hardness = random.gamma(2, 5, 60)
    better, worse = _sums(hardness * 0.7 + random.normal(0, 0.1, 60)), _sums(hardness)
    weights = draw_weights(60, 1000, 0)
    difference, ratio = difference_interval(better, worse, weights), ratio_interval(better, worse, weights)
    assert ratio.low[0] < ratio.value[0] < ratio.high[0] and ratio.value[0] == pytest.approx(0.7, abs=0.01)
    assert ratio.high[0] - ratio.low[0] < 0.02
    assert difference.high[0] < 0 and difference.value[0] == pytest.approx(-0.3 * hardness.mean(), abs=0.05)
    alone = mean_interval(better, weights)
    assert difference.high[0] - difference.low[0] < alone.high[0] - alone.low[0]


def test_where_nothing_counts_there_is_no_figure_and_one_block_has_no_interval() -> None:
    empty = BlockSums(np.zeros((3, 1)), np.zeros((3, 1)))
    found = mean_interval(empty, draw_weights(3, 10, 0))
    assert np.isnan([found.value[0], found.low[0], found.high[0]]).all()
    single = BlockSums(np.array([[1.0], [0.0]]), np.array([[1.0], [0.0]]))
    found = mean_interval(single, draw_weights(2, 10, 0))
    assert found.value[0] == 1.0 and np.isnan([found.low[0], found.high[0]]).all()
