"""JSON from elsewhere: exact numbers through a file, and a sentence for everything that is wrong."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.json_files import FormatError, numbers, read_json_object, whole_number, write_json


@given(values=st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_numbers_are_read_back_exactly(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("json") / "a.json"
    write_json(path, {"x": values})
    read = numbers(read_json_object(path)["x"], (len(values),), "x")
    assert read.tobytes() == np.array(values, dtype=np.float64).tobytes()


def test_nan_is_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": float("nan")})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "no such JSON"), (b"{", "no such JSON"), (b"\xff\xfe\x00", "no such JSON"),
        (b"[1]", "expected a JSON object"),
        (b'{"a": 1, "b": {"c": 1, "c": 2}}', "'c' occurs twice"), (b'{"a":' * 100_000, "nested without end"),
        (b'{"a": ' + b"9" * 5000 + b"}", "no such JSON"), (b'{"a": 1}' + b" " * 2000, "more than the 1000 "),
    ],
)  # fmt: skip
def test_bad_files_are_refused_with_their_name(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=reason) as refused:
        read_json_object(path, 1000 if b"  " in content else 2**20)
    assert str(refused.value).startswith(f"{path}: ")


def test_a_device_without_end_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "zero.json"
    path.symlink_to("/dev/zero")
    with pytest.raises(FormatError, match=r"zero\.json: is no regular file; check the path\."):
        read_json_object(path, 2**20)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "pipe.json"
    os.mkfifo(path)
    with pytest.raises(FormatError, match=r"pipe\.json: is no regular file; check the path\."):
        read_json_object(path)


def test_a_file_that_has_more_than_it_says_is_refused() -> None:
    path = Path("/proc/self/status")  # of size 0
    with pytest.raises(FormatError, match="has more bytes than its size of 0; wait until it is written"):
        read_json_object(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="No such file"):
        read_json_object(tmp_path / "none.json")


@pytest.mark.parametrize(
    "value",
    [None, 1.0, [], [1, 2], [1, 2, 3, 4], [1, 2, "3"], [1, 2, None], [1, 2, True], [1, 2, [3]], {"0": 1}, "123",
     [1, 2, 10**400], [1, 2, float("nan")], [1, 2, float("inf")]],
)  # fmt: skip
def test_only_three_finite_numbers_are_three_numbers(value: Any) -> None:
    with pytest.raises(FormatError, match=r"^place: "):
        numbers(value, (3,), "place")


def test_nan_passes_where_it_is_allowed() -> None:
    assert np.isnan(numbers([[1, float("nan")]], (1, 2), "place", is_finite=False)).tolist() == [[False, True]]


@pytest.mark.parametrize("value", [-1, 11, True, 1.0, "1", None])
def test_whole_numbers_within_bounds(value: Any) -> None:
    assert whole_number(10, "place", 0, 10) == 10
    with pytest.raises(FormatError, match="a whole number from 0 to 10"):
        whole_number(value, "place", 0, 10)
