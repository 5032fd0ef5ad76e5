"""How sure a mean is, and how sure the difference of two: bootstrap intervals over blocks of instants.

Errors of neighbouring frames, and of the joints of one hand, go together; so whole blocks are drawn again (stretches of
a sequence, or whole sequences), never single joints. Methods are compared in pairs: the same draws serve both, so that
what is hard for both cancels out. Percentile intervals (Efron & Tibshirani, *An Introduction to the Bootstrap*, 1993,
ch. 13); with fewer than about ten blocks they are too narrow, with fewer than five they are NaN.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int, Num, Shaped

Weights = Float[np.ndarray, "resample block"]
Values = Float[np.ndarray, "..."]
MIN_BLOCKS: Final = 5
"""Of fewer blocks no interval is given."""


@dataclass(frozen=True, eq=False)
class BlockSums:
    """What the means of some quantities over any choice of blocks follow from.

    Attributes:
        total: Sum of each quantity over each block.
        count: How much each block adds to the quantity's denominator.
    """

    total: Float[np.ndarray, "block quantity"]
    count: Float[np.ndarray, "block quantity"]

    def mean(self) -> Float[np.ndarray, " quantity"]:
        """Return the means over all blocks; NaN where nothing counts."""
        return _quotient(self.total.sum(axis=0), self.count.sum(axis=0))

    def resampled_means(self, weights: Weights) -> Float[np.ndarray, "resample quantity"]:
        """Return the means over every draw of blocks."""
        return _quotient(weights @ self.total, weights @ self.count)


@dataclass(frozen=True, eq=False)
class Interval:
    """Estimates and the bounds of their intervals."""

    value: Values
    low: Values
    high: Values


def block_sums(
    total: Num[np.ndarray, "row quantity"],
    count: Shaped[np.ndarray, "row quantity"],
    block: Int[np.ndarray, " row"],
    num_blocks: int,
) -> BlockSums:
    """Sum rows by the block, 0 to `num_blocks` - 1, that each belongs to."""

    def summed(values: Shaped[np.ndarray, "row quantity"]) -> Float[np.ndarray, "block quantity"]:
        columns = [np.bincount(block, weights=column, minlength=num_blocks) for column in values.T]
        return np.stack(columns, axis=1).astype(np.float64)

    return BlockSums(summed(total), summed(count))


def draw_weights(num_blocks: int, num_resamples: int, seed: int) -> Weights:
    """Return how often each block is drawn in each resample, `num_blocks` draws with replacement each."""
    draws = np.random.default_rng(seed).multinomial(num_blocks, np.full(num_blocks, 1 / num_blocks), num_resamples)
    return draws.astype(np.float64)


def mean_interval(sums: BlockSums, weights: Weights, level: float = 0.95) -> Interval:
    """Return the means and their intervals."""
    return _interval(sums.mean(), sums.resampled_means(weights), _num_known(sums), level)


def difference_interval(first: BlockSums, second: BlockSums, weights: Weights, level: float = 0.95) -> Interval:
    """Return the differences of means, first minus second, and their paired intervals."""
    resampled = first.resampled_means(weights) - second.resampled_means(weights)
    return _interval(first.mean() - second.mean(), resampled, _num_known(first, second), level)


def ratio_interval(first: BlockSums, second: BlockSums, weights: Weights, level: float = 0.95) -> Interval:
    """Return the ratios of means, first to second, and their paired intervals."""
    resampled = _quotient(first.resampled_means(weights), second.resampled_means(weights))
    return _interval(_quotient(first.mean(), second.mean()), resampled, _num_known(first, second), level)


def percentile_bounds(draws: Float[np.ndarray, " resample"], level: float = 0.95) -> tuple[float, float]:
    """Return the bounds that leave out equal shares of a figure's draws; those that are not known do not count."""
    tail = (1 - level) / 2
    low, high = np.quantile(draws[np.isfinite(draws)], (tail, 1 - tail))
    return float(low), float(high)


def _num_known(*sums: BlockSums) -> Int[np.ndarray, " quantity"]:
    """Return the number of blocks that say something about each quantity."""
    return np.asarray(np.min([(one.count > 0).sum(axis=0) for one in sums], axis=0))


def _interval(
    value: Values,
    resampled: Float[np.ndarray, "resample quantity"],
    num_known: Int[np.ndarray, " quantity"],
    level: float,
) -> Interval:
    """Return the percentile interval."""
    bounds = np.full((2, len(value)), np.nan)
    for quantity in np.flatnonzero(num_known >= MIN_BLOCKS):
        bounds[:, quantity] = percentile_bounds(resampled[:, quantity], level)
    return Interval(value, bounds[0], bounds[1])


def _quotient(numerator: Values, denominator: Values) -> Values:
    is_defined = denominator > 0
    return np.where(is_defined, numerator / np.where(is_defined, denominator, 1.0), np.nan)
