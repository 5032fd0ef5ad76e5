"""Content digests: what a table or a file *is*, whatever file format, compression or folder holds it."""

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

_BLOCK_BYTES = 1 << 20


def canonical_json(value: Any) -> str:
    """Return the one JSON text of a value: sorted keys, no spaces.

    Raises:
        TypeError: for anything that has no stable encoding (sets, floats that are not finite, objects, keys that are
            not strings): a cache key must never depend on chance.
    """
    return json.dumps(_checked(value, "value"), sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def digest_json(value: Any) -> str:
    """Return the sha256 (hex) of a value's canonical JSON."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def digest_table(table: pa.Table, blobs: tuple[str, ...] = ()) -> str:
    """Return the sha256 (hex) of a table's contents.

    Independent of chunking, slicing, padding and file encoding; every NaN counts as the same NaN. Of a blob column only
    the file's name counts: where it lies is no content (its sha256 stands in a column of its own).
    """
    digest = hashlib.sha256()
    for field in table.schema:
        digest.update(f"{field.name}:{field.type}:{table.num_rows};".encode())
        column = table.column(field.name).combine_chunks()
        if field.name in blobs:
            column = pa.array([Path(name).name for name in column.to_pylist()], pa.string())
        _update(digest, column)
    return digest.hexdigest()


def digest_file(path: Path) -> str:
    """Return the sha256 (hex) of a file's bytes; computed once per process and version of the file."""
    stat = path.stat()
    return _digest_file(str(path.resolve()), stat.st_size, stat.st_mtime_ns, stat.st_ino)


@cache
def _digest_file(path: str, size: int, mtime_ns: int, inode: int) -> str:
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
    return digest.hexdigest()


def _checked(value: Any, where: str) -> Any:
    if isinstance(value, Mapping):
        if bad := [key for key in value if not isinstance(key, str)]:
            raise TypeError(f"{where} has the key {bad[0]!r}, which is no string, so it has no stable digest")
        return {key: _checked(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_checked(item, f"{where}[{i}]") for i, item in enumerate(value)]
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    raise TypeError(f"{where} is {value!r} of type {type(value).__name__}, which has no stable digest")


def _update(digest: Any, array: pa.Array) -> None:
    """Feed an array without nulls to the digest, value by value."""
    kind = array.type
    if pa.types.is_fixed_size_list(kind):
        _update(digest, array.flatten())
    elif pa.types.is_string(kind) or pa.types.is_binary(kind):
        digest.update(pc.binary_length(array).to_numpy(zero_copy_only=False).astype("<i8").tobytes())
        digest.update(b"".join(scalar.as_buffer() for scalar in array))
    elif pa.types.is_floating(kind):
        values = array.to_numpy(zero_copy_only=False)
        digest.update(np.where(np.isnan(values), values.dtype.type(np.nan), values).tobytes())
    else:
        digest.update(np.ascontiguousarray(array.to_numpy(zero_copy_only=False)).tobytes())
