"""Loops over pixels, compiled by numba."""

import inspect
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def compiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Compile a function that uses numbers and arrays only.

    The machine code is kept beside the source, until the source file changes. A change in *another* file does not
    renew it: compiled functions call only compiled functions of their own file. No reordering of floating-point
    operations is allowed, so that results repeat.
    """
    plain = inspect.unwrap(function)  # tests wrap functions in checks of types, which numba cannot compile
    return cast(Callable[Arguments, Result], numba.njit(plain, nogil=True, cache=True, error_model="numpy"))
