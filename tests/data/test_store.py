import errno
import json
import os
import stat
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.entry_records import Record
from assemblyhands_core.data.store import DamagedEntry, Store, load
from assemblyhands_core.data.tables import TableSpec

SPEC = TableSpec(
    "films", 1, ("frame",), pa.schema([("frame", pa.int64()), ("film_file", pa.string()), ("reason", pa.string())])
)
PARTS = {"stage": "film", "config": {"a": 1}}
KEY = digest_json(PARTS)


def _write(store: Store, num_rows: int = 2) -> Record:
    table = SPEC.build({"frame": range(num_rows), "film_file": ["a.mp4"] * num_rows, "reason": ["", "dark"][:num_rows]})
    with store.draft("film", PARTS) as draft:
        (draft.folder / "a.mp4").write_bytes(b"film")
        return draft.write({"films": (SPEC, table)}, 1.5)


def test_an_entry_is_found_with_all_that_it_holds(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert store.find("film", KEY) is None
    written = _write(store)
    found = store.find("film", KEY)
    assert found == written
    assert found.key == KEY and found.blobs == {"a.mp4": 4} and found.parts == PARTS and found.seconds == 1.5
    assert found.outputs["films"].reasons == {"": 1, "dark": 1} and found.outputs["films"].num_rows == 2


def test_blobs_are_absolute_in_memory_and_relative_on_disk(tmp_path: Path) -> None:
    store = Store(tmp_path)
    record = _write(store)
    path = Path(store.read(record, "films", SPEC)["film_file"][0].as_py())
    assert path == store.entry("film", KEY) / "a.mp4" and path.read_bytes() == b"film"
    assert pa.parquet.read_table(store.entry("film", KEY) / "films.parquet")["film_file"][0].as_py() == "a.mp4"


def test_a_moved_workspace_still_works(tmp_path: Path) -> None:
    record = _write(Store(tmp_path / "here"))
    (tmp_path / "here").rename(tmp_path / "there")
    table = Store(tmp_path / "there").read(record, "films", SPEC)
    assert Path(table["film_file"][0].as_py()).read_bytes() == b"film"


def test_an_error_while_writing_leaves_nothing(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with pytest.raises(RuntimeError, match="stage broke"), store.draft("film", PARTS) as draft:
        (draft.folder / "a.mp4").write_bytes(b"fi")
        raise RuntimeError("stage broke")
    assert list(store.entries()) == [] and list(store.leftovers()) == []


def test_while_it_is_written_nobody_sees_it(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.draft("film", PARTS) as draft:
        draft.write({"films": (SPEC, SPEC.empty())}, 0.0)
        assert store.find("film", KEY) is None and list(store.entries()) == []
        assert draft.folder.name.startswith(".")
    assert store.find("film", KEY) is not None


def test_of_two_runs_that_write_the_same_entry_both_succeed(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.draft("film", PARTS) as slow:
        first = _write(store)
        (slow.folder / "a.mp4").write_bytes(b"film")
        second = slow.write(
            {"films": (SPEC, store.read(first, "films", SPEC).set_column(1, "film_file", [["a.mp4"] * 2]))}, 9.0
        )
    assert second.digests == first.digests
    assert store.find("film", KEY) == first and list(store.leftovers()) == []


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EACCES, errno.ETIMEDOUT, errno.ESTALE])
@pytest.mark.parametrize("file", ["films.parquet", "record.json"])
def test_what_cannot_be_read_now_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, number: int) -> None:
    store = Store(tmp_path)
    record, real = _write(store), Path.open

    def failing(path: Path, *arguments: str, **options: str) -> object:
        if path.name == file:
            raise OSError(number, os.strerror(number), str(path))
        return real(path, *arguments, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", failing)
    with pytest.raises(OSError, match=file) as refused:
        store.find("film", KEY)
    assert refused.value.errno == number
    monkeypatch.undo()
    assert store.find("film", KEY) == record and list(store.leftovers()) == []


@pytest.mark.parametrize(
    "error", [OSError(errno.EMFILE, "Too many open files"), pa.ArrowMemoryError("malloc of size 64 failed")]
)
def test_a_table_that_cannot_be_read_now_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    store = Store(tmp_path)
    record = _write(store)

    def read(file: object) -> None:
        raise error

    monkeypatch.setattr(pa.parquet.ParquetFile, "read", read)
    with pytest.raises(type(error)):
        store.read(record, "films", SPEC)
    path = store.entry("film", KEY) / "films.parquet"
    os.utime(path, (path.stat().st_mtime + 100,) * 2)  # touched since: then `find` reads it, too
    with pytest.raises(type(error)):
        store.find("film", KEY)
    assert path.exists() and list(store.leftovers()) == []
    monkeypatch.setattr(pa.parquet.ParquetFile, "read", lambda file: (_ for _ in ()).throw(OSError("wrong checksum")))
    with pytest.raises(DamagedEntry, match="wrong checksum"):
        store.read(record, "films", SPEC)
    assert not path.exists()


def _seen_late(monkeypatch: pytest.MonkeyPatch, store: Store, num_looks: int) -> list[float]:
    """Let the entry be seen only after so many looks, as on NFS; return the pauses between them."""
    real, pauses, entry = Path.is_dir, list[float](), store.entry("film", KEY)
    clock = [0.0]

    def sleep(seconds: float) -> None:
        pauses.append(seconds)
        clock[0] += seconds

    monkeypatch.setattr(Path, "is_dir", lambda path: (path != entry or len(pauses) >= num_looks) and real(path))
    monkeypatch.setattr("assemblyhands_core.data.store.time.sleep", sleep)
    monkeypatch.setattr("assemblyhands_core.data.store.time.monotonic", lambda: clock[0])
    return pauses


def test_what_another_host_has_made_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    record = _write(store)
    pauses = _seen_late(monkeypatch, store, 20)
    assert store.find("film", KEY) is None
    assert store.await_entry("film", KEY) == record and len(pauses) == 20


def test_what_another_host_was_first_to_make_may_be_seen_late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    record = _write(store)
    pauses = _seen_late(monkeypatch, store, 20)
    _write(store)
    assert len(pauses) == 20 and store.find("film", KEY) == record and list(store.leftovers()) == []


def test_what_is_not_to_be_seen_for_a_minute_has_vanished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    _write(store)
    pauses = _seen_late(monkeypatch, store, 1000)
    with pytest.raises(DamagedEntry, match=f"{KEY} has vanished; run again"):
        store.await_entry("film", KEY)
    assert 60 <= sum(pauses) < 70


def test_what_was_set_aside_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    _write(store)
    store.set_aside(store.entry("film", KEY), "faded")
    pauses = _seen_late(monkeypatch, store, 0)
    with pytest.raises(DamagedEntry, match="has vanished; run again"):
        store.await_entry("film", KEY)
    assert pauses == []


@pytest.mark.parametrize("file", ["films.parquet", "a.mp4", "record.json"])
@pytest.mark.parametrize("harm", ["cut", "empty", "remove"])
def test_a_damaged_entry_counts_as_absent_and_is_set_aside(tmp_path: Path, file: str, harm: str) -> None:
    store = Store(tmp_path)
    _write(store)
    path = store.entry("film", KEY) / file
    path.unlink() if harm == "remove" else path.write_bytes(path.read_bytes()[:-1] if harm == "cut" else b"")
    assert store.find("film", KEY) is None
    assert not store.entry("film", KEY).exists() and len(list(store.leftovers())) == 1
    assert _write(store).key == KEY


def test_a_flipped_bit_is_found_on_reading(tmp_path: Path) -> None:
    store = Store(tmp_path)
    record = _write(store)
    path = store.entry("film", KEY) / "films.parquet"
    content = bytearray(path.read_bytes())
    content[20] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(DamagedEntry, match="set aside, run again"):
        store.read(record, "films", SPEC)
    assert store.find("film", KEY) is None


@pytest.mark.parametrize(
    "change", [{"stage": "../film"}, {"key": "0" * 64}, {"blobs": {"../a.mp4": 4}}, {"blobs": {"/a": 1}}]
)
def test_a_record_that_leads_out_of_its_folder_is_not_believed(tmp_path: Path, change: dict[str, object]) -> None:
    store = Store(tmp_path)
    _write(store)
    path = store.entry("film", KEY) / "record.json"
    (path.parent.parent / "a.mp4").write_bytes(b"film")
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert store.find("film", KEY) is None and len(list(store.leftovers())) == 1


def test_a_record_without_end_counts_as_damaged(tmp_path: Path) -> None:
    store = Store(tmp_path)
    _write(store)
    (store.entry("film", KEY) / "record.json").write_text('{"a":' * 100_000)
    assert store.find("film", KEY) is None


@pytest.mark.parametrize("name", ["../a.mp4", "/etc/passwd", "..", "b/a.mp4"])
def test_a_table_that_names_files_outside_its_entry_is_refused(tmp_path: Path, name: str) -> None:
    store = Store(tmp_path)
    table = SPEC.build({"frame": [0], "film_file": [name], "reason": [""]})
    with store.draft("film", PARTS) as draft:
        record = draft.write({"films": (SPEC, table)}, 1.5)
    path = store.entry("film", KEY) / "films.parquet"
    with pytest.raises(OSError, match="column film_file names a file outside"):
        load(path)
    with pytest.raises(DamagedEntry, match="column film_file names a file outside"):
        store.read(record, "films", SPEC)


def test_load_reads_a_node_of_the_latest_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)
    _write(store)
    node = tmp_path / "runs" / "latest" / "shoot"
    (node / "films").mkdir(parents=True)
    (node / "manifest.json").write_text('{"tables": ["films", "other"]}')
    target = store.entry("film", KEY) / "films.parquet"
    (node / "films" / "one.parquet").symlink_to(os.path.relpath(target, node / "films"))
    monkeypatch.setenv("ASSEMBLYHANDS_WORK", str(tmp_path))
    frame = load("shoot")
    assert frame.frame.tolist() == [0, 1]
    assert [Path(p).read_bytes() for p in frame.film_file] == [b"film"] * 2
    np.testing.assert_array_equal(load(target).frame, load(node, "films").frame)
    with pytest.raises(FileNotFoundError, match="beside it there are: shoot"):
        load("shot")


def test_what_is_set_aside_says_why(tmp_path: Path) -> None:
    store = Store(tmp_path)
    _write(store)
    store.set_aside(store.entry("film", KEY), "a.mp4: faded")
    store.set_aside(store.entry("film", KEY), "another run was first")
    (aside,) = store.leftovers()
    assert (aside / "damaged.txt").read_text() == "a.mp4: faded\n" and (aside / "a.mp4").read_bytes() == b"film"


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_cannot_sync_folders_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    real = os.fsync

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    assert _write(Store(tmp_path)).key == KEY
    monkeypatch.setattr(os, "fsync", lambda descriptor: (_ for _ in ()).throw(OSError(errno.EIO, "broken")))
    with pytest.raises(OSError, match="broken"):
        _write(Store(tmp_path / "other"))
