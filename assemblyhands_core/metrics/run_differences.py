"""The same figure in two runs: by how much the first is above the second, with a paired interval."""

from collections.abc import Sequence
from typing import NamedTuple

import pyarrow as pa

from assemblyhands_core.metrics.bootstrap import BlockSums, Weights, difference_interval


class Difference(NamedTuple):
    """A figure in two runs, and by how much the first is above the second, with a paired interval."""

    table: str
    group: str
    metric: str
    first: float
    second: float
    value: float
    low: float
    high: float
    n: int


def make_difference(
    names: tuple[str, str, str], first: BlockSums, second: BlockSums, weights: Weights, level: float
) -> Difference:
    """Return the difference of a single mean.

    Args:
        names: Table, group and metric.
        first, second: Of each run, over the same blocks.
        weights: The draws of blocks, which serve both.
        level: Share of the draws within the interval.
    """
    found = difference_interval(first, second, weights, level)
    value, low, high = (float(values[0]) for values in (found.value, found.low, found.high))
    means = float(first.mean()[0]), float(second.mean()[0])
    return Difference(*names, *means, value, low, high, int(first.count.sum()))


def shared_rows(first: pa.Table, second: pa.Table, key: Sequence[str]) -> tuple[pa.Table, pa.Table]:
    """Return the rows of each table that the other one has too, in the order of the key.

    Args:
        first, second: Of two runs.
        key: The columns that tell a table's rows apart.
    """
    keys = [list(zip(*(table[name].to_pylist() for name in key), strict=True)) for table in (first, second)]
    both = set(keys[0]) & set(keys[1])
    order = [(name, "ascending") for name in key]
    kept = [
        table.filter(pa.array([one in both for one in of_table], pa.bool_())).sort_by(order)
        for table, of_table in zip((first, second), keys, strict=True)
    ]
    return kept[0], kept[1]
