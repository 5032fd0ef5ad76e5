"""The store: an action cache of stage results.

``<workspace>/store/<stage>/<key>/`` holds ``<output>.parquet``, blobs and ``record.json``. An entry is written to a
sibling folder whose name begins with a dot, synced and renamed, so that it exists whole or not at all: a killed run
leaves nothing that another run could take for a result, and two runs may write the same entry at once.
"""

import errno
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pyarrow as pa
import pyarrow.parquet as pq

from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.drafts import draft_beside
from assemblyhands_core.data.entry_records import RECORD, Output, Record, count_reasons, is_bare, looks_whole
from assemblyhands_core.data.tables import (
    BLOB_SUFFIX,
    OUTSIDE,
    TableError,
    TableSpec,
    as_written,
    check_room,
    is_damage,
    read_parquet,
    write_parquet,
)

if TYPE_CHECKING:
    import pandas as pd  # notebooks have it; the engine starts faster without

WHY_DAMAGED = "damaged.txt"
_LATE_S = 60.0  # NFS may show another host's folder so late (its option acdirmax)
_LOOK_AGAIN_S = 0.5
_NO_FOLDER_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)  # SMB and some FUSE file systems cannot sync folders


class DamagedEntry(RuntimeError):
    """A store entry is not what its record says; it was moved to ``store/.damaged`` and is rebuilt by the next run."""


@dataclass(frozen=True)
class Draft:
    """An entry in the making: blobs are put into ``folder``, then ``write`` adds the tables and the record."""

    folder: Path
    stage: str
    key: str
    parts: Mapping[str, Any]

    def write(self, tables: Mapping[str, tuple[TableSpec, pa.Table]], seconds: float) -> Record:
        """Write the tables and the record; return the record."""
        blobs = {path.name: path.stat().st_size for path in sorted(self.folder.iterdir())}
        outputs = {name: self._write_table(name, spec, table) for name, (spec, table) in tables.items()}
        record = Record(self.stage, self.key, self.parts, outputs, blobs, round(seconds, 3))
        (self.folder / RECORD).write_text(json.dumps(asdict(record), indent=1))
        return record

    def _write_table(self, name: str, spec: TableSpec, table: pa.Table) -> Output:
        path = self.folder / f"{name}.parquet"
        write_parquet(path, table, spec, {"stage": self.stage, "store_key": self.key})
        return Output(spec.digest(table), table.num_rows, path.stat().st_size, count_reasons(table))


class Store:
    """The entries below one workspace folder."""

    def __init__(self, workspace: Path) -> None:
        self.root = workspace / "store"

    def entry(self, stage: str, key: str) -> Path:
        """Return the folder of an entry, there or not."""
        return self.root / stage / key

    def find(self, stage: str, key: str) -> Record | None:
        """Return the record of a whole entry, or None; a damaged entry is moved away and counts as absent.

        Looks at sizes, times and Parquet's end marks only, so that thousands of entries are checked in a second; a
        table that is newer than its record was touched since, and is read.

        Raises:
            OSError, MemoryError: if it cannot be looked at now; it stays where it is.
        """
        folder = self.entry(stage, key)
        if not folder.is_dir():  # asked before its files are: another run may publish it any moment
            return None
        try:
            record = Record.from_json((folder / RECORD).read_text())
            is_own = (record.stage, record.key) == (stage, key) and not record.strays
            if is_own and looks_whole(folder, record):
                return record
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            if not is_damage(error):
                raise
            # no record, or one that is cut
        self.set_aside(folder, "sizes, times or ends of its files are not those of its record")
        return None

    def await_entry(self, stage: str, key: str) -> Record:
        """Return the record of an entry that somebody has made, whom this host may see late on a network file system.

        Raises:
            DamagedEntry: if it was set aside, or is not to be seen for a minute.
            OSError, MemoryError: if it cannot be looked at now.
        """
        self._await_folder(folder := self.entry(stage, key))
        if (record := self.find(stage, key)) is None:
            raise DamagedEntry(f"the entry {folder} has vanished; run again")
        return record

    def read(self, record: Record, output: str, spec: TableSpec) -> pa.Table:
        """Return a table of an entry, blob columns as absolute paths.

        Raises:
            DamagedEntry: if the file is damaged or its contents are not those of the record.
            OSError, MemoryError: if it cannot be read now; the entry stays where it is.
        """
        folder = self.entry(record.stage, record.key)
        try:
            table = read_parquet(folder / f"{output}.parquet", spec)
            if spec.digest(table) != record.outputs[output].digest:
                raise TableError("its contents have another digest than its record")
            return _absolute(table, spec.blobs, folder)
        except TableError as error:
            self.set_aside(folder, f"{output}.parquet: {error}")
            raise DamagedEntry(f"{folder / output}.parquet: {error}; the entry was set aside, run again") from error

    @contextmanager
    def draft(self, stage: str, parts: Mapping[str, Any]) -> Iterator["Draft"]:
        """Give a draft to write an entry in; on leaving without error it becomes the entry, else it vanishes."""
        key = digest_json(parts)
        folder = draft_beside(self.entry(stage, key))
        folder.mkdir(parents=True)
        try:
            yield Draft(folder, stage, key, parts)
            _sync(folder)
            self._publish(folder, self.entry(stage, key))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def entries(self) -> Iterator[Path]:
        """Yield the folder of every entry."""
        for stage in sorted(path for path in self.root.glob("[!.]*") if path.is_dir()):
            yield from sorted(path for path in stage.glob("[!.]*") if path.is_dir())

    def leftovers(self) -> Iterator[Path]:
        """Yield folders that killed runs or damaged entries left behind."""
        yield from sorted(self.root.glob("*/.*"))
        yield from sorted(self.root.glob(".damaged/*"))

    def set_aside(self, folder: Path, reason: str) -> None:
        """Move a damaged entry to ``store/.damaged``, with the reason beside its files; the next run makes it anew."""
        target = self.root / ".damaged" / f"{_name_aside(folder)}-{uuid.uuid4().hex[:8]}"
        target.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):  # another run was first
            folder.rename(target)
            with suppress(OSError):  # the disk may be full
                (target / WHY_DAMAGED).write_text(f"{reason}\n", encoding="utf-8")

    def _await_folder(self, folder: Path) -> None:
        """Wait until an entry is to be seen that has to be there, unless it was set aside: then nobody knows."""
        deadline = time.monotonic() + _LATE_S
        while not folder.is_dir() and not self._was_set_aside(folder) and time.monotonic() < deadline:
            time.sleep(_LOOK_AGAIN_S)

    def _was_set_aside(self, folder: Path) -> bool:
        return any((self.root / ".damaged").glob(f"{_name_aside(folder)}-*"))

    def _publish(self, draft: Path, entry: Path) -> None:
        try:
            draft.rename(entry)
        except OSError as error:
            # Another run made the same entry first: same key, and either's contents will do. A damaged one makes way.
            if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
                self._await_folder(entry)
            if self.find(entry.parent.name, entry.name) is None:
                draft.rename(entry)
        _sync_folder(entry.parent)


def load(path_or_node: str | Path, table: str | None = None, *, run: str = "latest") -> "pd.DataFrame":
    """Return a table of a run as a DataFrame, for notebooks.

    Args:
        path_or_node: a node of the run (``"round_0"``), a folder of a run's view, or a Parquet file.
        table: which of the node's tables; its first by default.
        run: name of the run below ``work/runs`` (or ``$ASSEMBLYHANDS_WORK/runs``).

    Returns:
        One row per row of the table; ``np.stack(df.joints_world_mm).reshape(-1, 21, 3)`` are joints in world mm. Blob
        columns are absolute paths.

    Raises:
        FileNotFoundError: naming what is absent and what there is.
        OSError: naming a file that is damaged.
    """
    return cast("pd.DataFrame", load_table(path_or_node, table, run).to_pandas())


def load_table(path_or_node: str | Path, table: str | None = None, run: str = "latest") -> pa.Table:
    """Return what `load` does, as an Arrow table."""
    path = Path(path_or_node)
    if not path.exists():
        path = workspace_folder() / "runs" / run / path_or_node
    if path.is_dir() and (manifest := path / "manifest.json").exists():
        path = path / (table or json.loads(manifest.read_text())["tables"][0])
    files = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not files or not path.exists():
        there = sorted(p.name for p in path.parent.glob("*")) if path.parent.is_dir() else []
        raise FileNotFoundError(f"{path} holds no table; beside it there are: {', '.join(there) or 'no files'}")
    return pa.concat_tables([_load_file(file) for file in files])


def workspace_folder() -> Path:
    """Return the workspace: ``$ASSEMBLYHANDS_WORK``, or ``work`` in the current folder."""
    return Path(os.environ.get("ASSEMBLYHANDS_WORK", "work")).absolute()


def _load_file(file: Path) -> pa.Table:
    real = file.resolve()
    try:
        table = _read_verified(real)
        return _absolute(table, [name for name in table.schema.names if name.endswith(BLOB_SUFFIX)], real.parent)
    except (OSError, pa.ArrowException, TableError, UnicodeDecodeError) as error:
        raise OSError(f"{file} cannot be read ({error}); run the command that made it again") from error


def _absolute(table: pa.Table, blobs: Sequence[str], folder: Path) -> pa.Table:
    """Return a table whose blob columns are paths in a folder instead of names.

    Raises:
        TableError: a name leads out of the folder.
    """
    for name in blobs:
        values = table.column(name).to_pylist()
        if odd := [value for value in values if value and not (is_bare(value) or name in OUTSIDE)]:
            raise TableError(f"column {name} names a file outside {folder}: {odd[0][:200]!r}")
        paths = [str(folder / value) if value else "" for value in values]
        table = table.set_column(table.schema.get_field_index(name), name, pa.array(paths, pa.string()))
    return table


def _name_aside(folder: Path) -> str:
    """Return how the names begin that an entry gets when it is set aside."""
    return f"{folder.parent.name}-{folder.name[:16]}"


def _read_verified(path: Path) -> pa.Table:
    """Read a table as it was written, without its definition; a page whose checksum is wrong is an OSError."""
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        check_room(file, path)
        table = file.read().replace_schema_metadata(None)
    table.validate(full=True)
    return table.cast(as_written(table.schema))


def _sync(folder: Path) -> None:
    for path in folder.iterdir():
        if not path.is_symlink():
            with path.open("rb") as file:
                os.fsync(file.fileno())
    _sync_folder(folder)


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_FOLDER_SYNC:
            raise
    finally:
        os.close(descriptor)
