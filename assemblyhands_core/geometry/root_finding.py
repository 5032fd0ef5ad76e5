"""Roots of polynomials and of small systems of equations, many at once."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

Rows = Float64[np.ndarray, "row unknown"]

_TOLERANCE = 1e-12
_MAX_ITERATIONS = 30


def polynomial(
    coefficients: Float64[np.ndarray, " degree"], s: Float64[np.ndarray, "*batch"]
) -> Float64[np.ndarray, "*batch"]:
    """Evaluate Σ c_i sⁱ for ascending coefficients by Horner's rule."""
    value = np.full_like(s, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * s + coefficient
    return np.asarray(value)  # numpy makes a scalar of a single value


def slope(
    coefficients: Float64[np.ndarray, " degree"], s: Float64[np.ndarray, "*batch"]
) -> Float64[np.ndarray, "*batch"]:
    """Evaluate the derivative of that polynomial."""
    return polynomial(coefficients[1:] * np.arange(1, len(coefficients)), s)


def first_positive_root(coefficients: Float64[np.ndarray, " degree"]) -> float:
    """Return the least positive real root of a polynomial with ascending coefficients; infinity without one."""
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(np.asarray(coefficients), "b"))
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(real[real > 0].min(initial=np.inf))


def solve_2x2(
    a: Float64[np.ndarray, " row"],
    b: Float64[np.ndarray, " row"],
    c: Float64[np.ndarray, " row"],
    d: Float64[np.ndarray, " row"],
    right: Float64[np.ndarray, "row 2"],
) -> Float64[np.ndarray, "row 2"]:
    """Solve [[a, b], [c, d]] x = right for every row; NaN where the determinant is not positive.

    A map with that Jacobian folds over there and has no inverse.
    """
    determinant = a * d - b * c
    inverse = 1.0 / np.where(determinant > 0, determinant, np.nan)
    return np.stack((d * right[:, 0] - b * right[:, 1], a * right[:, 1] - c * right[:, 0]), axis=-1) * inverse[:, None]


def newton(step: Callable[[Rows, Rows], tuple[Rows, Rows]], target: Rows, start: Rows) -> Rows:
    """Solve for every row; only rows that have not converged keep iterating, rows that never do become NaN.

    Args:
        step: From rows of the solution and of the target to the error and to the Newton step that removes it.
        target: What the map of the solution has to equal.
        start: NaN where there is no solution; changed in place.
    """
    active = np.flatnonzero(np.isfinite(start).all(axis=1))
    start[np.isnan(start).any(axis=1)] = np.nan
    for _ in range(_MAX_ITERATIONS):
        error, change = step(start[active], target[active])
        allowed = _TOLERANCE * (1 + np.abs(target[active]).max(axis=1, initial=0))
        unconverged = ~(np.abs(error).max(axis=1, initial=0) <= allowed)
        active = active[unconverged]
        if not len(active):
            break
        start[active] -= change[unconverged]
    start[active] = np.nan
    return start
