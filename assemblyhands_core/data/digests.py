"""Content digests: what a table or a file *is*, whatever file format, compression or folder holds it."""

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from assemblyhands_core.data.drafts import replaced_whole

Chunks = Callable[[], Iterable[pa.Array]]


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
    return digest_columns(table.schema, table.num_rows, lambda name: table.column(name).chunks, blobs)


def digest_columns(
    schema: pa.Schema, num_rows: int, chunks_of: Callable[[str], Iterable[pa.Array]], blobs: tuple[str, ...] = ()
) -> str:
    """Return what `digest_table` does of a table that comes in pieces, so that it need not fit into memory.

    Args:
        schema, num_rows: of the whole table.
        chunks_of: gives the pieces of a column by its name, in order; asked again for texts.
        blobs: columns of which only the files' names count.
    """
    digest = hashlib.sha256()
    for field in schema:
        digest.update(f"{field.name}:{field.type}:{num_rows};".encode())
        chunks = partial(chunks_of, field.name)
        _update(digest, field.type, partial(_names, chunks) if field.name in blobs else chunks)
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

    def forget(self, path: Path) -> None:
        """Read a file again when next asked, though its size and time are what they were."""
        gone = [version for version in self._known if version.startswith(f"{path.resolve()}|")]
        for version in gone:
            del self._known[version]
        if gone:
            self._save()

    def _save(self) -> None:
        with replaced_whole(self._memory) as draft:
            draft.write_text(json.dumps(self._known, indent=0))


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


def _names(chunks: Chunks) -> Iterable[pa.Array]:
    return (pa.array([Path(name).name for name in chunk.to_pylist()], pa.string()) for chunk in chunks())


def _update(digest: Any, kind: pa.DataType, chunks: Chunks) -> None:
    """Feed a column without nulls to the digest, value by value."""
    if pa.types.is_fixed_size_list(kind):
        _update(digest, kind.value_type, lambda: (chunk.flatten() for chunk in chunks()))
    elif pa.types.is_string(kind) or pa.types.is_binary(kind):
        for chunk in chunks():
            digest.update(pc.binary_length(chunk).to_numpy(zero_copy_only=False).astype("<i8").tobytes())
        for chunk in chunks():
            digest.update(b"".join(scalar.as_buffer() for scalar in chunk))
    elif pa.types.is_floating(kind):
        for chunk in chunks():
            values = chunk.to_numpy(zero_copy_only=False)
            digest.update(np.where(np.isnan(values), values.dtype.type(np.nan), values).tobytes())
    elif pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        for chunk in chunks():
            digest.update(np.ascontiguousarray(chunk.to_numpy(zero_copy_only=False)).tobytes())
    else:
        raise TypeError(
            f"a column of type {kind} has no stable digest; tables hold numbers, texts and fixed-size lists"
        )
