"""Whether an entry of the store is still what it was: everything is read, nothing is believed from sizes and times.

A record belongs to its folder if its parts have the folder's key as digest. The tables have the record's digests, and
say in their rows what the sha256 of each blob is.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.data.digests import digest_file, digest_json
from assemblyhands_core.data.entry_records import RECORD, Output, Record, count_reasons
from assemblyhands_core.data.tables import BLOB_SUFFIX, digest_parquet, is_damage

Digest = Callable[[Path], str]


@dataclass(frozen=True)
class Flaw:
    """What is wrong with a file of an entry.

    Attributes:
        is_damage: else the file could not be looked at now (no permission, a server that is away).
        is_silent: size and time gave no sign of it, so that a stage may have read the file as it is.
    """

    file: Path
    reason: str
    is_damage: bool = True
    is_silent: bool = False


class InodeDigests:
    """File digests, each file read once however many links lead to it. Several threads may ask."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], str] = {}
        self._locks: dict[tuple[int, ...], threading.Lock] = {}

    def __call__(self, path: Path) -> str:
        """Return the sha256 (hex) of a file's bytes."""
        stat = path.stat()
        inode = (stat.st_dev, stat.st_ino, stat.st_size, stat.st_mtime_ns)
        with self._locks.setdefault(inode, threading.Lock()):
            if inode not in self._known:
                self._known[inode] = digest_file(path)
        return self._known[inode]


def examine(folder: Path, digest: Digest = digest_file) -> list[Flaw]:
    """Return all that is wrong with an entry; nothing if it vanished meanwhile.

    Args:
        folder: the entry.
        digest: gives the sha256 of a blob.
    """
    flaws = list(_flaws(folder, digest))
    return flaws if folder.is_dir() else []


def digests_of_blob_tables(folder: Path) -> set[str]:
    """Return the digests of an entry's tables that tell of blobs: what reads those names them in its record."""
    record = Record.from_json((folder / RECORD).read_text(encoding="utf-8"))
    names = {name: pq.read_schema(folder / f"{name}.parquet").names for name in record.outputs}
    return {
        record.outputs[name].digest for name in names if any(column.endswith(BLOB_SUFFIX) for column in names[name])
    }


def _flaws(folder: Path, digest: Digest) -> Iterator[Flaw]:
    records: list[Record] = []
    yield from _look(folder / RECORD, lambda: _wrong_with_record(folder, records))
    for record in records:
        digests: dict[str, str] = {}
        for name, output in record.outputs.items():
            path = folder / f"{name}.parquet"
            wrong = list(_look(path, partial(_wrong_with_table, record, name, output, path)))
            yield from wrong or _look(path, partial(_note_blob_digests, path, digests))
        yield from _blob_flaws(folder, record.blobs, digests, digest)


def _look(file: Path, find_wrong: Callable[[], str]) -> Iterator[Flaw]:
    """Yield a flaw if something is wrong with a file, or it cannot be read at all."""
    try:
        if wrong := find_wrong():
            yield Flaw(file, wrong)
    except OSError as error:
        yield Flaw(file, f"it cannot be read ({error.strerror or _line(error)})", is_damage=is_damage(error))
    except MemoryError:
        yield Flaw(file, "there is not enough memory to read it", is_damage=False)
    except Exception as error:  # whatever a decoder makes of bytes that nobody wrote
        yield Flaw(file, f"it cannot be decoded ({type(error).__name__}: {_line(error)})")


def _line(error: Exception) -> str:
    return " ".join(str(error).split())  # Parquet's sentences are several lines


def _wrong_with_record(folder: Path, found: list[Record]) -> str:
    """Say what is wrong with an entry's record; if nothing is, add it to those found."""
    record = Record.from_json((folder / RECORD).read_text(encoding="utf-8"))
    if (record.stage, record.key) != (folder.parent.name, folder.name):
        return f"it is of another entry, {record.stage}/{record.key}"
    if digest_json(record.parts) != record.key:
        return "what it says the entry was made from has another digest than the entry's key"
    if odd := record.strays:
        return f"it names a file outside its folder, {odd[0]}"
    found.append(record)
    return ""


def _wrong_with_table(record: Record, name: str, output: Output, path: Path) -> str:
    if (num_bytes := path.stat().st_size) != output.num_bytes:
        return f"it has {num_bytes} bytes instead of {output.num_bytes}"
    header = pq.read_metadata(path)
    if header.num_rows != output.num_rows:
        return f"it has {header.num_rows} rows instead of {output.num_rows}"
    wanted = record.parts.get("tables", {}).get(name)
    if wanted and (found := _definition(header.metadata or {})) != wanted:
        return f"it is a table {found} instead of {wanted}"
    if digest_parquet(path) != output.digest:
        return "its contents have another digest than its record says"
    if _count_reasons(path, header.schema.to_arrow_schema()) != output.reasons:
        return "its reasons are others than its record counts"
    return ""


def _definition(metadata: Mapping[bytes, bytes]) -> str:
    return " v".join(metadata.get(key, b"").decode(errors="replace") for key in (b"table", b"table_version"))


def _count_reasons(path: Path, schema: pa.Schema) -> Mapping[str, int]:
    return count_reasons(_read_columns(path, "reason")) if "reason" in schema.names else {}


def _note_blob_digests(path: Path, found: dict[str, str]) -> str:
    """Add the sha256 of every blob that a table tells of, by the blob's name; nothing is wrong with that.

    It stands in the column that is called like the file's, ``video_file`` and ``video_sha256``, or in ``sha256``.
    """
    names = pq.read_schema(path).names
    for column in (name for name in names if name.endswith(BLOB_SUFFIX)):
        beside = f"{column.removesuffix(BLOB_SUFFIX)}_sha256"
        if digests := [name for name in (beside, "sha256") if name in names][:1]:
            pairs = _read_columns(path, column, *digests).to_pydict()
            found |= dict(zip(pairs[column], pairs[digests[0]], strict=True))
    return ""


def _read_columns(path: Path, *names: str) -> pa.Table:
    return pq.ParquetFile(path, page_checksum_verification=True).read(list(names))


def _blob_flaws(folder: Path, sizes: Mapping[str, int], digests: Mapping[str, str], digest: Digest) -> Iterator[Flaw]:
    for name, num_bytes in sizes.items():
        path, link = folder / name, _link_of(folder / name)
        found = list(_look(path, partial(_wrong_size, path, num_bytes, link)))
        yield from found
        if not found and name in digests:
            wrong = _look(path, partial(_wrong_contents, path, digests[name], digest, link))
            yield from (replace(flaw, is_silent=flaw.is_damage) for flaw in wrong)


def _wrong_size(path: Path, wanted: int, link: str) -> str:
    if not path.exists():
        return f"it is gone{link}"
    num_bytes = path.stat().st_size
    return "" if num_bytes == wanted else f"it has {num_bytes} bytes instead of {wanted}{link}"


def _wrong_contents(path: Path, wanted: str, digest: Digest, link: str) -> str:
    return "" if digest(path) == wanted else f"its contents have another sha256 than its table says{link}"


def _link_of(path: Path) -> str:
    return f" (it is a link to {path.readlink()})" if path.is_symlink() else ""
