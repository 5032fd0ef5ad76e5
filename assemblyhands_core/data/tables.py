"""Tables that stages exchange: name, version, key and columns, checked whenever one is written or read."""

import errno
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.data.arrays import Column, to_arrow
from assemblyhands_core.data.digests import digest_columns, digest_table
from assemblyhands_core.hands.joints import JOINT_NAMES

BLOB_SUFFIX = "_file"
OUTSIDE = ("image_file",)
"""Of these columns those that name the user's own pictures, by absolute paths."""
_DEFINITION = (b"table", b"table_version")
MAX_DENSE_BYTES = 2**30
"""However well it is packed, a table may unpack to so much."""
_MAX_PACKING, _VALUE_BYTES = 100, 8
_BLOCK_BYTES = 32 << 20  # of a table that is digested at once
_COMPRESSION: Literal["zstd"] = "zstd"

_DAMAGE_ERRORS = (None, errno.EIO, errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP)  # None: Parquet's own


class TableError(ValueError):
    """A table does not keep to its definition; the message names table, column and both values."""


@dataclass(frozen=True)
class TableSpec:
    """The definition of a table.

    Attributes:
        name: what stages and folders call it.
        version: raised whenever the meaning of a column changes.
        key: columns that together identify a row.
        schema: columns with units in their names. No nulls: a hole is NaN with a reason beside it. A column whose name
            ends in ``_file`` holds a blob: a name relative to the store entry on disk, an absolute path in memory.
    """

    name: str
    version: int
    key: tuple[str, ...]
    schema: pa.Schema

    @property
    def blobs(self) -> tuple[str, ...]:
        """Return the columns that hold files."""
        return tuple(name for name in self.schema.names if name.endswith(BLOB_SUFFIX))

    def build(self, columns: Mapping[str, Column]) -> pa.Table:
        """Return a checked table made of columns, each (rows,) or, for fixed-size lists, (rows, ...)."""
        if missing := set(self.schema.names) ^ set(columns):
            raise TableError(f"table {self.name} is built with other columns than it has: {sorted(missing)}")
        arrays = [to_arrow(columns[field.name], field.type) for field in self.schema]
        return self.check(pa.Table.from_arrays(arrays, schema=self.schema))

    def from_rows(self, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
        """Return a checked table made of one mapping a row."""
        return self.build({name: [row[name] for row in rows] for name in self.schema.names})

    def empty(self) -> pa.Table:
        """Return the table without rows."""
        return self.schema.empty_table()

    def check(self, table: pa.Table) -> pa.Table:
        """Return the table if it keeps to this definition.

        Raises:
            TableError: on another schema, a null or a repeated key.
        """
        if not table.schema.equals(self.schema, check_metadata=False):
            raise TableError(f"table {self.name} v{self.version} has {_difference(table.schema, self.schema)}")
        for name in self.schema.names:
            if table.column(name).null_count:
                raise TableError(f"table {self.name}: column {name} holds nulls; write NaN and a reason")
        keys = table.select(list(self.key))
        if keys.group_by(list(self.key)).aggregate([]).num_rows != table.num_rows:
            raise TableError(f"table {self.name}: the key ({', '.join(self.key)}) repeats among {table.num_rows} rows")
        return table

    def digest(self, table: pa.Table) -> str:
        """Return the content digest of a table of this definition."""
        return digest_table(table, self.blobs)


def is_damage(error: Exception) -> bool:
    """Whether an error of reading tells of the file, else of this moment: no permission, no memory, a server away."""
    return error.errno in _DAMAGE_ERRORS if isinstance(error, OSError) else not isinstance(error, MemoryError)


def write_parquet(path: Path, table: pa.Table, spec: TableSpec, provenance: Mapping[str, str]) -> None:
    """Write a checked table: zstd, floats byte-stream-split, definition and provenance in the file's metadata."""
    spec.check(table)
    metadata = {"table": spec.name, "table_version": str(spec.version), "key": ",".join(spec.key), **provenance}
    if "joints_world_mm" in spec.schema.names:
        metadata |= {"joint_order": ",".join(JOINT_NAMES), "unit": "mm"}
    floats = [_leaf(field) for field in spec.schema if pa.types.is_floating(_value_type(field.type))]
    strings = [_leaf(field) for field in spec.schema if pa.types.is_string(_value_type(field.type))]
    pq.write_table(
        table.replace_schema_metadata(metadata),
        path,
        compression=_COMPRESSION,
        use_dictionary=strings or False,
        use_byte_stream_split=floats or False,
        write_page_checksum=True,
    )


def read_parquet(path: Path, spec: TableSpec) -> pa.Table:
    """Read and check a table.

    Raises:
        TableError: if the file is damaged or absent, or holds another table or version than asked for.
        OSError, MemoryError: if it cannot be read now.
    """
    try:
        with pq.ParquetFile(path, memory_map=False, page_checksum_verification=True) as file:
            metadata = file.metadata.metadata or {}
            found = tuple(metadata.get(key, b"nothing").decode(errors="replace") for key in _DEFINITION)
            if found != (spec.name, str(spec.version)):
                raise TableError(f"{path} holds table {found[0]} v{found[1]}, wanted {spec.name} v{spec.version}")
            check_room(file, path)
            if odd := set(file.schema_arrow.names) ^ set(spec.schema.names):
                raise TableError(f"{path} is table {spec.name} but for its columns {', '.join(sorted(odd))[:200]}")
            table = file.read().cast(spec.schema)
        table.validate(full=True)  # texts may be no text
        return spec.check(table)
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        if not is_damage(error):
            raise
        raise TableError(f"{path} cannot be read as Parquet ({error})") from error


def check_room(file: pq.ParquetFile, path: Path) -> None:
    """Refuse a small file that unpacks to gigabytes: a column of one value a billion times takes a few kilobytes.

    Raises:
        TableError: it declares as many values.
    """
    # Not from the columns' own metadata: at damaged ones this version of pyarrow ends the process.
    num_rows = sum(file.metadata.row_group(group).num_rows for group in range(file.metadata.num_row_groups))
    is_list = pa.types.is_fixed_size_list
    declared = sum(_VALUE_BYTES * num_rows * (t.list_size if is_list(t) else 1) for t in file.schema_arrow.types)
    if declared > max(MAX_DENSE_BYTES, _MAX_PACKING * path.stat().st_size):
        raise TableError(f"{path} has {path.stat().st_size} bytes and declares {declared}; no table packs so well")


def digest_parquet(path: Path) -> str:
    """Return the content digest of a table's file, read in blocks: a table may be larger than memory.

    Raises:
        OSError, pyarrow.ArrowException: the file cannot be read, or the checksum of a page is wrong.
    """
    with pq.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False, page_checksum_verification=True) as file:
        schema, num_rows = as_written(file.schema_arrow), file.metadata.num_rows
        blobs = tuple(name for name in schema.names if name.endswith(BLOB_SUFFIX))
        num_bytes = sum(file.metadata.row_group(i).total_byte_size for i in range(file.num_row_groups))
        if num_bytes <= _BLOCK_BYTES:
            table = file.read()
            return digest_columns(schema, num_rows, lambda name: table.column(name).chunks, blobs)
        num_block_rows = max(1, _BLOCK_BYTES * num_rows // num_bytes)
        return digest_columns(schema, num_rows, lambda name: _column_blocks(file, name, num_block_rows), blobs)


def as_written(schema: pa.Schema) -> pa.Schema:
    """Return the schema of the table that was written to a file, without its definition.

    Parquet calls a list's values "element", which is part of their type and so of the digest.
    """
    kinds = [
        pa.list_(kind.value_type, kind.list_size) if pa.types.is_fixed_size_list(kind) else kind
        for kind in schema.types
    ]
    return pa.schema(list(zip(schema.names, kinds, strict=True)))


def _column_blocks(file: pq.ParquetFile, name: str, num_rows: int) -> Iterator[pa.Array]:
    return (batch.column(0) for batch in file.iter_batches(num_rows, columns=[name]))


def _value_type(kind: pa.DataType) -> pa.DataType:
    return kind.value_type if pa.types.is_fixed_size_list(kind) else kind


def _leaf(field: pa.Field) -> str:
    """Return the Parquet path of a column's values."""
    return f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else str(field.name)


def _difference(found: pa.Schema, wanted: pa.Schema) -> str:
    have = {field.name: str(field.type) for field in found}
    want = {field.name: str(field.type) for field in wanted}
    odd = [f"{n} {have.get(n, 'missing')} instead of {want.get(n, 'nothing')}"
           for n in dict.fromkeys([*want, *have]) if have.get(n) != want.get(n)]  # fmt: skip
    return ", ".join(odd) or f"columns in the order {', '.join(have)} instead of {', '.join(want)}"
