"""Between numpy arrays of shape (rows, values) and Arrow columns of fixed-size lists, and choices of rows."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

Column: TypeAlias = Sequence[Any] | npt.NDArray[Any] | Any  # or an Arrow array


def to_arrow(values: Column, kind: pa.DataType) -> pa.Array:
    """Return values as an Arrow array of the given type.

    Args:
        values: for a fixed-size list of length K an array of shape (rows, ...) with K values a row; otherwise (rows,).
        kind: the column's type.

    Raises:
        ValueError: if a row has another number of values than the type.
    """
    if isinstance(values, pa.ChunkedArray):
        return values.combine_chunks().cast(kind)
    if isinstance(values, pa.Array):
        return values.cast(kind)
    if not pa.types.is_fixed_size_list(kind):
        return pa.array(values, type=kind)
    rows = np.asarray(values, dtype=_numpy_dtype(kind.value_type))
    flat = rows.reshape(len(rows), -1) if len(rows) else rows.reshape(0, kind.list_size)
    if flat.shape[1] != kind.list_size:
        raise ValueError(f"a row has {flat.shape[1]} values, the column type {kind} takes {kind.list_size}")
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel(), type=kind.value_type), kind.list_size)


def to_numpy(column: pa.Array | pa.ChunkedArray) -> npt.NDArray[Any]:
    """Return a column as an array of shape (rows,), or (rows, K) for fixed-size lists of length K."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if not pa.types.is_fixed_size_list(array.type):
        return np.asarray(array.to_numpy(zero_copy_only=False))
    values = array.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(values).reshape(len(array), array.type.list_size)


def evenly_spread(num_rows: int, max_count: int) -> list[int]:
    """Return at most so many row numbers, evenly spread from the first to the last row."""
    return sorted(set(np.linspace(0, num_rows - 1, min(max_count, num_rows)).round().astype(int).tolist()))


def _numpy_dtype(kind: pa.DataType) -> Any:
    return object if pa.types.is_string(kind) else kind.to_pandas_dtype()
