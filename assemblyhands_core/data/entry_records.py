"""What an entry of the store holds, as its ``record.json`` says, and whether its files look like it."""

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from assemblyhands_core.data.tables import digest_parquet, is_damage

RECORD = "record.json"
_PARQUET_MAGIC = b"PAR1"


@dataclass(frozen=True)
class Output:
    """One table of an entry: content digest, number of rows, size of its file and, where it has one, rows by reason."""

    digest: str
    num_rows: int
    num_bytes: int
    reasons: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """What an entry holds and what made it.

    Attributes:
        stage, key: where the entry lies.
        parts: everything that the key is the digest of, so that a later run can say what differs.
        outputs: the tables, by name.
        blobs: sizes in bytes of the other files, by name.
        seconds: how long the stage took.
    """

    stage: str
    key: str
    parts: Mapping[str, Any]
    outputs: Mapping[str, Output]
    blobs: Mapping[str, int]
    seconds: float

    @classmethod
    def from_json(cls, text: str) -> "Record":
        """Return the record that a ``record.json`` holds."""
        values = json.loads(text)
        values["outputs"] = {name: Output(**output) for name, output in values["outputs"].items()}
        return cls(**values)

    @property
    def strays(self) -> list[str]:
        """Names of tables and blobs that lead out of the entry's folder."""
        return [name for name in [*self.outputs, *self.blobs] if not is_bare(name)]

    @property
    def digests(self) -> dict[str, str]:
        """Content digest of every output."""
        return {name: output.digest for name, output in self.outputs.items()}


def is_bare(name: str) -> bool:
    """Return whether a name is that of a file in a folder, and leads to no other folder."""
    return Path(name).name == name and name != ".."


def count_reasons(table: pa.Table) -> dict[str, int]:
    """Count rows (of per-joint reasons: joints) by reason; the empty reason is success."""
    if "reason" not in table.schema.names:
        return {}
    reasons = table.column("reason").combine_chunks()
    values = reasons.flatten() if pa.types.is_fixed_size_list(reasons.type) else reasons
    counts = values.value_counts().to_pylist()
    return {item["values"]: item["counts"] for item in sorted(counts, key=lambda item: str(item["values"]))}


def looks_whole(folder: Path, record: Record) -> bool:
    """Return whether the files' sizes, times and Parquet end marks are what the record says.

    A table that is newer than its record was touched since, and is read.
    """
    tables = {folder / f"{name}.parquet": output for name, output in record.outputs.items()}
    return (
        all(_is_parquet(path, output.num_bytes) for path, output in tables.items())
        and all((folder / name).stat().st_size == size for name, size in record.blobs.items())
        and _untouched_since(folder / RECORD, tables)
    )


def _untouched_since(record: Path, tables: Mapping[Path, Output]) -> bool:
    """Whether the tables are older than their record, which was written last, or hold what it says all the same."""
    written_ns = record.stat().st_mtime_ns
    newer = {path: output for path, output in tables.items() if path.stat().st_mtime_ns > written_ns}
    if not all(_has_digest(path, output.digest) for path, output in newer.items()):
        return False
    if newer:  # a copied workspace, for example: look once
        with suppress(OSError):
            record.touch()
    return True


def _has_digest(path: Path, digest: str) -> bool:
    try:
        return digest_parquet(path) == digest
    except pa.ArrowException as error:
        if not is_damage(error):
            raise
        return False


def _is_parquet(path: Path, num_bytes: int) -> bool:
    with path.open("rb") as file:
        head = file.read(4)
        if file.seek(0, os.SEEK_END) != num_bytes or num_bytes < len(_PARQUET_MAGIC):
            return False
        file.seek(-4, os.SEEK_END)
        return head == _PARQUET_MAGIC == file.read(4)
