from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from assemblyhands_core.data import tables
from assemblyhands_core.data.store import load
from assemblyhands_core.data.tables import TableError, TableSpec, digest_parquet, read_parquet, write_parquet
from assemblyhands_core.detectors.base import DetectorError
from assemblyhands_core.detectors.precomputed import PrecomputedHands
from assemblyhands_core.hands.joints import JOINT_NAMES

SPEC = TableSpec(
    "poses",
    2,
    ("frame",),
    pa.schema([("frame", pa.int64()), ("joints_world_mm", pa.list_(pa.float32(), 63)), ("reason", pa.string())]),
)


def _poses(num_rows: int = 3) -> pa.Table:
    joints = np.arange(num_rows * 63, dtype=np.float32).reshape(num_rows, 21, 3)
    return SPEC.build({"frame": np.arange(num_rows), "joints_world_mm": joints, "reason": ["", "x", ""][:num_rows]})


def test_written_and_read_back_it_is_the_same(tmp_path: Path) -> None:
    table = _poses()
    write_parquet(tmp_path / "t.parquet", table, SPEC, {"stage": "s"})
    assert read_parquet(tmp_path / "t.parquet", SPEC).equals(table)


def test_the_file_says_what_it_is_and_splits_float_bytes(tmp_path: Path) -> None:
    write_parquet(tmp_path / "t.parquet", _poses(), SPEC, {"stage": "s"})
    file = pq.ParquetFile(tmp_path / "t.parquet")
    metadata = file.schema_arrow.metadata
    assert metadata[b"table"] == b"poses" and metadata[b"table_version"] == b"2" and metadata[b"stage"] == b"s"
    assert metadata[b"joint_order"].decode().split(",") == list(JOINT_NAMES) and metadata[b"unit"] == b"mm"
    column = file.metadata.row_group(0).column(1)
    assert "BYTE_STREAM_SPLIT" in column.encodings and column.compression == "ZSTD"


def test_a_small_file_that_unpacks_to_gigabytes_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, spec = tmp_path / "t.parquet", TableSpec("a", 1, ("x",), pa.schema([("x", pa.int64())]))
    part = pa.table({"x": np.zeros(2**20, dtype=np.int64)}).replace_schema_metadata(
        {"table": "a", "table_version": "1"}
    )
    with pq.ParquetWriter(path, part.schema) as writer:
        for _ in range(129):
            writer.write_table(part)
    assert path.stat().st_size < 10**6
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_: pytest.fail("unpacked"))
    monkeypatch.setattr(pq, "read_table", lambda *_, **__: pytest.fail("unpacked"))
    with pytest.raises(TableError, match=r"t\.parquet has \d+ bytes and declares 1082130432; no table packs so well"):
        read_parquet(path, spec)
    with pytest.raises(OSError, match="no table packs so well"):
        load(path)
    with pytest.raises(DetectorError, match="no table packs so well"):
        PrecomputedHands(path)
    monkeypatch.setattr(tables, "MAX_DENSE_BYTES", 2**31)
    with pytest.raises(pytest.fail.Exception, match="unpacked"):
        read_parquet(path, spec)


@pytest.mark.parametrize("harmed", [b"poses", b"frame", b"table_version"])
def test_words_that_are_no_text_are_refused(tmp_path: Path, harmed: bytes) -> None:
    path = tmp_path / "t.parquet"
    write_parquet(path, _poses(), SPEC, {"stage": "s"})
    path.write_bytes(path.read_bytes().replace(harmed, b"\xfe" + harmed[1:]))
    with pytest.raises(TableError, match=r"t\.parquet"):
        read_parquet(path, SPEC)
    if harmed == b"frame":
        with pytest.raises(OSError, match=r"t\.parquet cannot be read"):
            load(path)


def test_texts_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    odd = pa.array([b"\xfe", b"", b""]).view(pa.string())
    table = _poses().set_column(2, "reason", odd)
    pq.write_table(table.replace_schema_metadata({"table": "poses", "table_version": "2"}), path)
    with pytest.raises(TableError, match=r"t\.parquet cannot be read as Parquet"):
        read_parquet(path, SPEC)
    with pytest.raises(OSError, match=r"t\.parquet cannot be read"):
        load(path)
    hands = {"camera": odd, "frame": [0] * 3, "hand": ["left"] * 3}
    hands |= {"keypoints_px": [[0.0] * 42] * 3, "confidence": [[0.0] * 21] * 3}
    pq.write_table(pa.table(hands), path)
    with pytest.raises(DetectorError, match=r"t\.parquet cannot be read as keypoints"):
        PrecomputedHands(path)


def test_pandas_stacks_it_directly(tmp_path: Path) -> None:
    write_parquet(tmp_path / "t.parquet", _poses(), SPEC, {})
    frame = pq.read_table(tmp_path / "t.parquet").to_pandas()
    assert np.stack(frame.joints_world_mm).reshape(-1, 21, 3)[2, 20, 2] == 3 * 63 - 1


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"frame": [0, 0]}, r"the key \(frame\) repeats among 2 rows"),
        ({"frame": [0, None]}, "column frame holds nulls"),
        ({"extra": [1, 2]}, "other columns than it has: ..extra"),
    ],
)
def test_what_breaks_the_definition_is_refused(columns: dict[str, list[object]], message: str) -> None:
    good = {"frame": [0, 1], "joints_world_mm": np.zeros((2, 63)), "reason": ["", ""]}
    with pytest.raises(TableError, match=message):
        SPEC.build({**good, **columns})


def test_another_type_is_named() -> None:
    with pytest.raises(TableError, match="frame int32 instead of int64"):
        SPEC.check(_poses().cast(SPEC.schema.set(0, pa.field("frame", pa.int32()))))


def test_another_version_is_named(tmp_path: Path) -> None:
    write_parquet(tmp_path / "t.parquet", _poses(), SPEC, {})
    newer = TableSpec("poses", 3, SPEC.key, SPEC.schema)
    with pytest.raises(TableError, match="holds table poses v2, wanted poses v3"):
        read_parquet(tmp_path / "t.parquet", newer)


def test_a_file_that_is_no_parquet_is_named(tmp_path: Path) -> None:
    (tmp_path / "t.parquet").write_bytes(b"PAR1 nonsense PAR1")
    with pytest.raises(TableError, match="cannot be read as Parquet"):
        read_parquet(tmp_path / "t.parquet", SPEC)


def test_blobs_are_the_columns_that_say_so() -> None:
    assert TableSpec("t", 1, ("a",), pa.schema([("a", pa.int8()), ("video_file", pa.string())])).blobs == (
        "video_file",
    )
    assert SPEC.empty().num_rows == 0


@pytest.mark.parametrize("block_bytes", [1, 200, 1 << 30])
def test_a_file_has_the_digest_of_its_table_however_large_the_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block_bytes: int
) -> None:
    table = _poses()
    monkeypatch.setattr("assemblyhands_core.data.tables._BLOCK_BYTES", block_bytes)
    for rows in (table, table.slice(0, 0)):
        write_parquet(tmp_path / "t.parquet", rows, SPEC, {"stage": "s"})
        assert digest_parquet(tmp_path / "t.parquet") == SPEC.digest(rows)
