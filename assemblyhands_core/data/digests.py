"""Content digests: what a table or a file *is*, whatever file format, compression or folder holds it."""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc


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


def digest_folder(path: Path) -> str:
    """Return a digest of where a folder is and of its files' names, sizes and times: too many to read them all."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    facts = [(str(file.relative_to(path)), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return digest_json([str(path), *map(list, facts)])


def digest_file(path: Path) -> str:
    """Return the sha256 (hex) of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class FileDigests:
    """File digests, remembered between runs in a JSON file by path, size, time and inode.

    Hashing a terabyte of video takes long; a file that still has the same size, time and inode is not read again.
    """

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._known: dict[str, str] = _read_json(memory)

    def __call__(self, path: Path) -> str:
        """Return the sha256 (hex) of a file's bytes."""
        stat = path.stat()
        version = f"{path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}|{stat.st_ino}"
        if version not in self._known:
            self._known[version] = digest_file(path)
            self._save()
        return self._known[version]

    def _save(self) -> None:
        self._memory.parent.mkdir(parents=True, exist_ok=True)
        partial = self._memory.with_name(f".{self._memory.name}-{os.getpid()}")
        partial.write_text(json.dumps(self._known, indent=0))
        partial.rename(self._memory)


def _read_json(path: Path) -> dict[str, str]:
    try:
        values = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


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
    elif pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        digest.update(np.ascontiguousarray(array.to_numpy(zero_copy_only=False)).tobytes())
    else:
        raise TypeError(
            f"a column of type {kind} has no stable digest; tables hold numbers, texts and fixed-size lists"
        )
