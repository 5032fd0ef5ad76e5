"""Compiled functions give what the plain ones give, also where tests check types."""

import numpy as np

from assemblyhands_core.synthetic import shadows
from assemblyhands_core.synthetic.compiled import compiled


def total(values: np.ndarray) -> float:
    result = 0.0
    for value in values:
        result += value
    return result


def test_the_sum_is_in_the_stated_order() -> None:
    values = np.random.default_rng(0).normal(size=1001) * 10.0 ** np.random.default_rng(1).integers(-9, 9, 1001)
    assert compiled(total)(values) == total(values)


def test_any_three_blocks_by_three_ask_for_all_points_of_a_lamp() -> None:
    for top in range(0, 40, 4):
        for left in range(0, 40, 4):
            pixels = [(top + y, left + x) for y in range(12) for x in range(12)]
            first = [pixel for pixel in pixels if shadows._is_first(*pixel)]
            assert len(first) == 9 and {shadows._target(*pixel) for pixel in first} == set(range(8))
