import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.arrays import to_arrow, to_numpy


def test_rows_of_values_become_fixed_size_lists_and_return() -> None:
    values = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    column = to_arrow(values, pa.list_(pa.float32(), 6))
    assert column.to_pylist() == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10, 11]]
    np.testing.assert_array_equal(to_numpy(column).reshape(2, 3, 2), values)


def test_a_slice_keeps_its_own_rows() -> None:
    column = to_arrow(np.arange(12.0).reshape(4, 3), pa.list_(pa.float64(), 3)).slice(1, 2)
    np.testing.assert_array_equal(to_numpy(column), [[3, 4, 5], [6, 7, 8]])


def test_texts_and_flags_in_lists() -> None:
    texts = to_arrow([["a", ""], ["", "b"]], pa.list_(pa.string(), 2))
    assert to_numpy(texts).tolist() == [["a", ""], ["", "b"]]
    flags = to_arrow(np.array([[True, False]]), pa.list_(pa.bool_(), 2))
    assert to_numpy(flags).dtype == bool


def test_no_rows() -> None:
    assert to_numpy(to_arrow([], pa.list_(pa.float32(), 63))).shape == (0, 63)


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="a row has 4 values"):
        to_arrow(np.zeros((2, 4)), pa.list_(pa.float32(), 3))
