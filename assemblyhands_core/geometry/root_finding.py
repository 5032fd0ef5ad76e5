"""Roots of polynomials and of small systems of equations, many at once."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]

_TOLERANCE = 1e-12
_MAX_ITERATIONS = 30


def polynomial(coefficients: Doubles, s: Doubles) -> Doubles:
    """Evaluate Σ c_i sⁱ for ascending coefficients by Horner's rule."""
    value = np.full_like(s, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = value * s + coefficient
    return value


def slope(coefficients: Doubles, s: Doubles) -> Doubles:
    """Evaluate the derivative of that polynomial."""
    return polynomial(coefficients[1:] * np.arange(1, len(coefficients)), s)


def first_positive_root(coefficients: npt.NDArray[Any]) -> float:
    """Return the least positive real root of a polynomial with ascending coefficients; infinity without one."""
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(np.asarray(coefficients), "b"))
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(real[real > 0].min(initial=np.inf))


def solve_2x2(a: Doubles, b: Doubles, c: Doubles, d: Doubles, right: Doubles) -> Doubles:
    """Solve [[a, b], [c, d]] x = right for every row `(N, 2)`; NaN where the determinant is not positive.

    A map with that Jacobian folds over there and has no inverse.
    """
    determinant = a * d - b * c
    inverse = 1.0 / np.where(determinant > 0, determinant, np.nan)
    return np.stack((d * right[:, 0] - b * right[:, 1], a * right[:, 1] - c * right[:, 0]), axis=-1) * inverse[:, None]


def newton(step: Callable[[Doubles, Doubles], tuple[Doubles, Doubles]], target: Doubles, start: Doubles) -> Doubles:
    """Solve for every row; only rows that have not converged keep iterating, rows that never do become NaN.

    Args:
        step: From rows of the solution and of the target to the error and to the Newton step that removes it.
        target: `(N, K)`.
        start: `(N, K)`, NaN where there is no solution; changed in place.
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
