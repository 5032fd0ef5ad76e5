import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.metrics.bootstrap import block_sums, draw_weights
from assemblyhands_core.metrics.run_differences import make_difference, shared_rows


def test_a_difference_is_of_means_and_the_draws_are_paired() -> None:
    block = np.arange(8) // 1
    hard = np.array([1.0, 9, 2, 8, 3, 7, 4, 6])
    ones = np.ones((8, 1))
    first, second = (block_sums(values[:, None], ones, block, 8) for values in (hard + 2, hard))
    found = make_difference(("table", "group", "metric"), first, second, draw_weights(8, 300, 0), 0.95)
    assert found[:3] == ("table", "group", "metric") and found[3:6] == (7.0, 5.0, 2.0) and found.n == 8
    assert (found.low, found.high) == (pytest.approx(2.0), pytest.approx(2.0))


def test_rows_that_both_have_come_in_the_order_of_the_key() -> None:
    first = pa.table({"name": ["b", "a", "a"], "number": [1, 2, 1], "value": [10, 20, 30]})
    second = pa.table({"name": ["a", "c", "b"], "number": [1, 1, 1], "value": [7, 8, 9]})
    one, other = shared_rows(first, second, ("name", "number"))
    assert one["value"].to_pylist() == [30, 10] and other["value"].to_pylist() == [7, 9]
    assert shared_rows(first, second.slice(1, 1), ("name", "number"))[0].num_rows == 0
