"""Roots with known values."""

import numpy as np

from assemblyhands_core.geometry.root_finding import first_positive_root, newton, polynomial, slope, solve_2x2


def test_polynomial_and_slope() -> None:
    coefficients, s = np.array([1.0, -2.0, 3.0]), np.array([0.0, 2.0])
    np.testing.assert_array_equal(polynomial(coefficients, s), [1.0, 9.0])  # 1 - 2 s + 3 s²
    np.testing.assert_array_equal(slope(coefficients, s), [-2.0, 10.0])


def test_first_positive_root() -> None:
    assert abs(first_positive_root(np.array([6.0, -5.0, 1.0])) - 2.0) < 1e-12  # (s - 2)(s - 3)
    assert abs(first_positive_root(np.array([-6.0, 1.0, 1.0, 0.0])) - 2.0) < 1e-12  # (s - 2)(s + 3)
    assert first_positive_root(np.array([1.0, 0.0, 1.0])) == np.inf
    assert first_positive_root(np.array([1.0])) == np.inf


def test_solve_2x2_refuses_folds() -> None:
    one = np.ones(2)
    solved = solve_2x2(3 * one, one, one, np.array([2.0, 0.3]), np.array([[5.0, 5.0], [1.0, 1.0]]))
    np.testing.assert_allclose(solved[0], [1.0, 2.0], rtol=0, atol=1e-15)
    assert np.isnan(solved[1]).all()


def test_newton_solves_rows_and_gives_up_on_rows_without_solution() -> None:
    def step(x: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        error = x * x - target
        return error, error / (2 * x)

    found = newton(step, np.array([[4.0], [-1.0], [9.0]]), np.array([[3.0], [0.7], [np.nan]]))
    np.testing.assert_allclose(found[0], 2.0, rtol=0, atol=1e-12)
    assert np.isnan(found[1:]).all()
