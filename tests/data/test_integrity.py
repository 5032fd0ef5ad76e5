import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from assemblyhands_core.data.digests import digest_file, digest_json
from assemblyhands_core.data.entry_records import Record
from assemblyhands_core.data.integrity import InodeDigests, digests_of_blob_tables, examine
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.tables import TableSpec

FILMS = TableSpec(
    "films",
    1,
    ("frame",),
    pa.schema([(name, pa.string()) for name in ("film_file", "film_sha256", "reason")]).insert(
        0, pa.field("frame", pa.int64())
    ),
)
PARTS = {"stage": "film", "config": {"a": 1}, "inputs": {}, "tables": {"films": "films v1"}}
KEY = digest_json(PARTS)


@pytest.fixture
def entry(tmp_path: Path) -> Path:
    """An entry with a blob of its own, and one that is a link."""
    (tmp_path / "source.mp4").write_bytes(b"source")
    store = Store(tmp_path)
    with store.draft("film", PARTS) as draft:
        (draft.folder / "a.mp4").write_bytes(b"film")
        (draft.folder / "b.mp4").symlink_to(tmp_path / "source.mp4")
        (draft.folder / "notes.txt").write_bytes(b"no table tells of it")
        names = ["a.mp4", "b.mp4", ""]
        digests = [digest_file(draft.folder / name) if name else "" for name in names]
        columns = {"frame": range(3), "film_file": names, "film_sha256": digests, "reason": ["", "", "dark"]}
        draft.write({"films": (FILMS, FILMS.build(columns))}, 1.5)
    return store.entry("film", KEY)


def _flip(file: Path, place: int) -> None:
    """Flip a bit as an ageing disk does, which changes no time."""
    times, content = file.stat(), bytearray(file.read_bytes())
    content[place] ^= 0x10
    file.write_bytes(bytes(content))
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))


def _said(entry: Path) -> list[tuple[str, str]]:
    return [(flaw.file.name, flaw.reason) for flaw in examine(entry)]


def test_a_whole_entry_has_no_flaws(entry: Path) -> None:
    assert examine(entry) == [] == examine(entry, InodeDigests())


def test_tables_that_tell_of_blobs_are_known_by_their_digests(entry: Path) -> None:
    record = Store(entry.parents[2]).find("film", KEY)
    assert record is not None and digests_of_blob_tables(entry) == set(record.digests.values())


def test_an_entry_that_vanishes_has_no_flaws(entry: Path) -> None:
    assert examine(entry.with_name("0" * 64)) == []


@pytest.mark.parametrize("name", ["a.mp4", "b.mp4"])
def test_a_faded_blob_is_found_though_size_and_time_are_the_same(entry: Path, name: str) -> None:
    _flip(entry / name, 2)
    (flaw,) = examine(entry)
    assert flaw.file == entry / name and flaw.is_damage and flaw.is_silent
    link = f" (it is a link to {entry.parents[2] / 'source.mp4'})" if name == "b.mp4" else ""
    assert flaw.reason == f"its contents have another sha256 than its table says{link}"
    assert Store(entry.parents[2]).find("film", KEY) is not None, "sizes and times say nothing"


def test_lost_and_cut_blobs_are_told_apart(entry: Path) -> None:
    (entry.parents[2] / "source.mp4").unlink()
    (entry / "a.mp4").write_bytes(b"fi")
    (entry / "notes.txt").unlink()
    flaws = examine(entry)
    assert [(flaw.file.name, flaw.reason.split(" (")[0]) for flaw in flaws] == [
        ("a.mp4", "it has 2 bytes instead of 4"), ("b.mp4", "it is gone"), ("notes.txt", "it is gone"),
    ]  # fmt: skip
    assert not any(flaw.is_silent for flaw in flaws), "whoever looks an entry up sees this"


def test_no_flipped_bit_of_a_table_changes_what_is_read(entry: Path) -> None:
    """Wherever it is, it is found, or what is read is what was written (statistics, provenance)."""
    table, record = entry / "films.parquet", Store(entry.parents[2]).find("film", KEY)
    assert record is not None
    content, written, num_found = table.read_bytes(), pq.read_table(table).replace_schema_metadata(None), 0
    for place in range(0, len(content), 11):
        _flip(table, place)
        if _said(entry):
            num_found += 1
        else:
            assert pq.read_table(table).replace_schema_metadata(None).equals(written)
            Store(entry.parents[2]).read(record, "films", FILMS)
        table.write_bytes(content)
    assert num_found > 0.3 * len(content) / 11
    assert _said(entry) == []


def _change(entry: Path, change: Callable[[dict[str, object]], object]) -> None:
    values = json.loads((entry / "record.json").read_text())
    change(values)
    (entry / "record.json").write_text(json.dumps(values))


@pytest.mark.parametrize(
    ("change", "file", "reason"),
    [
        (lambda r: r["parts"]["config"].update(a=2), "record.json", "another digest than the entry's key"),
        (lambda r: r.update(key="0"), "record.json", "it is of another entry, film/0"),
        (lambda r: r.update(stage="cut"), "record.json", "it is of another entry, cut/"),
        (lambda r: r["blobs"].update({"../../a": 3}), "record.json", "a file outside its folder, ../../a"),
        (lambda r: r.pop("outputs"), "record.json", "it cannot be decoded (KeyError"),
        (lambda r: r["outputs"]["films"].update(digest="0"), "films.parquet", "another digest than its record"),
        (lambda r: r["outputs"]["films"].update(num_rows=4), "films.parquet", "it has 3 rows instead of 4"),
        (lambda r: r["outputs"]["films"].update(num_bytes=4), "films.parquet", "bytes instead of 4"),
        (lambda r: r["outputs"]["films"].update(reasons={"dark": 3}), "films.parquet", "others than its record counts"),
        (lambda r: r["blobs"].update({"a.mp4": 3}), "a.mp4", "it has 4 bytes instead of 3"),
    ],
)
def test_a_record_is_held_against_its_entry(
    entry: Path, change: Callable[[dict[str, object]], object], file: str, reason: str
) -> None:
    _change(entry, change)
    ((found, said),) = _said(entry)
    assert found == file and reason in said


def test_every_flipped_bit_of_a_record_is_found_unless_it_is_in_the_time_taken(entry: Path) -> None:
    path = entry / "record.json"
    content, before = path.read_bytes(), Record.from_json(path.read_text())
    for place in range(0, len(content), 3):
        _flip(path, place)
        if not _said(entry):
            after = Record.from_json(path.read_text())
            assert (after.parts, after.outputs, after.blobs) == (before.parts, before.outputs, before.blobs)
        path.write_bytes(content)


@pytest.mark.parametrize("name", ["record.json", "films.parquet"])
def test_lost_files_are_named(entry: Path, name: str) -> None:
    (entry / name).unlink()
    assert _said(entry) == [(name, "it cannot be read (No such file or directory)")]


@pytest.mark.parametrize(("number", "is_damage"), [(errno.EIO, True), (errno.ESTALE, False), (errno.EACCES, False)])
def test_what_cannot_be_looked_at_now_is_not_called_damaged(entry: Path, number: int, is_damage: bool) -> None:
    def digest(path: Path) -> str:
        raise OSError(number, os.strerror(number))

    flaws = examine(entry, digest)
    assert [flaw.file.name for flaw in flaws] == ["a.mp4", "b.mp4"]
    assert {flaw.is_damage for flaw in flaws} == {is_damage}


def test_a_file_with_many_links_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, same, other = tmp_path / "a", tmp_path / "b", tmp_path / "c"
    file.write_bytes(b"film")
    same.hardlink_to(file)
    other.write_bytes(b"film")
    read: list[Path] = []

    def digest(path: Path) -> str:
        read.append(path)
        return digest_file(path)

    monkeypatch.setattr("assemblyhands_core.data.integrity.digest_file", digest)
    digests = InodeDigests()
    assert digests(file) == digests(same) == digests(other) == digest_file(file)
    assert read == [file, other]
