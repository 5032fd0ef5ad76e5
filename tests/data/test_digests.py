import datetime
import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.digests import FileDigests, canonical_json, digest_file, digest_json, digest_table


def _table(values: list[float], names: list[str]) -> pa.Table:
    lists = pa.FixedSizeListArray.from_arrays(pa.array(np.repeat(values, 2), pa.float32()), 2)
    return pa.table({"value": pa.array(values), "name": names, "pair": lists, "flag": [v > 1 for v in values]})


def test_canonical_json_is_one_text_for_one_value() -> None:
    assert canonical_json({"b": (1, 2.5), "a": None}) == '{"a":null,"b":[1,2.5]}'
    assert digest_json({"b": 1, "a": 2}) == digest_json({"a": 2, "b": 1}) != digest_json({"a": 2, "b": 1.5})
    assert digest_json("") == hashlib.sha256(b'""').hexdigest()


@pytest.mark.parametrize("value", [{1: "a"}, {"a": {1, 2}}, [float("nan")], [float("inf")], object(), b"x"])
def test_what_has_no_stable_encoding_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="no stable digest"):
        canonical_json(value)


def test_a_table_is_its_contents_whatever_its_chunks_and_slices() -> None:
    whole = _table([1.0, 2.0, 3.0], ["a", "bc", ""])
    chunked = pa.concat_tables([whole.slice(0, 1), whole.slice(1, 2)])
    sliced = _table([0.0, 1.0, 2.0, 3.0, 9.0], ["x", "a", "bc", "", "y"]).slice(1, 3)
    assert digest_table(whole) == digest_table(chunked) == digest_table(sliced)


def test_every_change_of_a_table_shows() -> None:
    table = _table([1.0, 2.0], ["ab", "c"])
    others = [
        _table([1.0, 2.5], ["ab", "c"]),
        _table([1.0, 2.0], ["a", "bc"]),
        table.slice(0, 1),
        table.rename_columns(["other", "name", "pair", "flag"]),
        table.cast(table.schema.set(0, pa.field("value", pa.float32()))),
    ]
    assert len({digest_table(t) for t in [table, *others]}) == 6


@pytest.mark.parametrize("values", [[[1], [2, 3]], [{"a": 1}], [datetime.date(2026, 1, 1)]])
def test_a_column_without_stable_bytes_is_refused(values: list[object]) -> None:
    with pytest.raises(TypeError, match="has no stable digest"):
        digest_table(pa.table({"x": values}))


def test_every_nan_is_the_same() -> None:
    strange = np.array([0x7FF8000000000001, 0xFFF8000000000000], dtype=np.uint64).view(np.float64)
    assert digest_table(pa.table({"x": strange})) == digest_table(pa.table({"x": [np.nan, np.nan]}))


def test_of_a_blob_only_its_name_counts() -> None:
    here, there = pa.table({"video_file": ["/a/b/cam.mp4"]}), pa.table({"video_file": ["cam.mp4"]})
    assert digest_table(here, ("video_file",)) == digest_table(there, ("video_file",))
    assert digest_table(here) != digest_table(there)


def test_file_digests_are_remembered_until_the_file_changes(tmp_path: Path) -> None:
    file = tmp_path / "video.mp4"
    file.write_bytes(b"first")
    assert FileDigests(tmp_path / "memory.json")(file) == digest_file(file) == hashlib.sha256(b"first").hexdigest()
    memory = (tmp_path / "memory.json").read_text()
    FileDigests(tmp_path / "memory.json")(file)
    assert (tmp_path / "memory.json").read_text() == memory
    file.write_bytes(b"second")
    assert FileDigests(tmp_path / "memory.json")(file) == hashlib.sha256(b"second").hexdigest()


def test_two_hosts_whose_processes_have_the_same_number_do_not_share_a_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, drafts = Path.write_text, list[Path]()

    def write_text(path: Path, *arguments: Any, **options: Any) -> int:
        drafts.append(path)
        if len(drafts) == 1:  # the other host is at the same point
            FileDigests(tmp_path / "memory.json")(tmp_path / "b")
        return real(path, *arguments, **options)

    for name in "ab":
        (tmp_path / name).write_bytes(b"")
    monkeypatch.setattr(Path, "write_text", write_text)
    FileDigests(tmp_path / "memory.json")(tmp_path / "a")
    assert len(drafts) == len(set(drafts)) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "memory.json"]


def test_a_broken_memory_is_no_memory(tmp_path: Path) -> None:
    (tmp_path / "memory.json").write_text("{broken")
    (tmp_path / "a").write_bytes(b"")
    assert FileDigests(tmp_path / "memory.json")(tmp_path / "a") == hashlib.sha256(b"").hexdigest()


def test_a_forgotten_file_is_read_again(tmp_path: Path) -> None:
    file, other = tmp_path / "cam.mp4", tmp_path / "cam.mp4.txt"
    file.write_bytes(b"film")
    other.write_bytes(b"text")
    digests = FileDigests(tmp_path / "memory.json")
    before = (digests(file), digests(other))
    times = file.stat()
    with file.open("r+b") as rotting:
        rotting.write(b"firm")
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert (FileDigests(tmp_path / "memory.json")(file), digests(other)) == before
    digests.forget(file)
    again = FileDigests(tmp_path / "memory.json")
    assert again(file) == hashlib.sha256(b"firm").hexdigest() and again(other) == before[1]
