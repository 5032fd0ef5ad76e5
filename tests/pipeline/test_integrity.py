import errno
import json
import os
import shutil
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from assemblyhands_core.data.digests import FileDigests, digest_file
from assemblyhands_core.data.store import Store
from pipeline.commands import _lock, execute
from pipeline.config import FsckConfig, UserError
from pipeline.damage import Damage, checks, find_damage, find_suspects
from pipeline.integrity import fsck


def _fsck(toy: Any, dry_run: bool = False, num_threads: int = 2) -> tuple[int, list[str]]:
    config = toy.config().model_copy(update={"fsck": FsckConfig(dry_run=dry_run, num_threads=num_threads)})
    console = Console(record=True, width=140, quiet=False, file=open(os.devnull, "w"))  # noqa: SIM115, PTH123
    code = fsck(config, console)
    return code, console.export_text().splitlines()


def _files(workspace: Path) -> dict[str, str]:
    found = sorted(path for path in workspace.rglob("*") if path.is_file() and "runs" not in path.parts)
    return {str(path.relative_to(workspace)): digest_file(path) for path in found}


def _table(toy: Any, node: str, shard: str) -> Path:
    folder: Path = toy.workspace / "runs/latest" / node / "numbers"
    return (folder / f"{shard}.parquet").resolve()


def _rot(file: Path) -> None:
    """Flip a bit as an ageing disk does, which changes no time."""
    times, content = file.stat(), bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0x10
    file.write_bytes(bytes(content))
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))


def test_a_whole_workspace_is_said_to_be(toy: Any) -> None:
    toy.run()
    before = _files(toy.workspace)
    code, said = _fsck(toy)
    assert code == 0 and len(said) == 1
    assert said[0].startswith("checked 4 entries and recordings (") and said[0].endswith("): whole")
    assert _files(toy.workspace) == before


def test_an_empty_workspace_is_whole(toy: Any) -> None:
    assert _fsck(toy)[0] == 0 and not (toy.workspace / "store").exists()


def test_bit_rot_that_no_run_would_notice_is_named_set_aside_and_made_anew(toy: Any) -> None:
    toy.run("first")
    before, file = _files(toy.workspace), _table(toy, "total", "one")
    _rot(file)
    assert set(toy.status(toy.run("second")).values()) == {"reused"}, "a run looks at sizes and times"
    code, said = _fsck(toy)
    assert code == 1 and len(said) == 2
    assert said[0].startswith(f"{file}: it cannot be ") and said[0].endswith("; set aside; made anew by: make toy")
    assert said[1].endswith(": 1 damaged, 0 could not be read, 0 flaws in runs")
    assert not file.parent.exists()
    (aside,) = (toy.workspace / "store/.damaged").iterdir()
    assert (aside / "damaged.txt").read_text().startswith("numbers.parquet: it cannot be ")
    assert toy.status(toy.run("third")) == {"cut one": "reused", "times one.00000": "reused",
                                            "times one.00001": "reused", "total one": "done"}  # fmt: skip
    after = _files(toy.workspace)
    assert {name for name in before if after[name] != before[name]} <= {
        str(file.parent.relative_to(toy.workspace) / "record.json")  # the time that it took
    }
    assert _fsck(toy)[0] == 0


def test_a_dry_run_only_reports(toy: Any) -> None:
    toy.run()
    _rot(_table(toy, "total", "one"))
    (toy.store.entry("multiply", "0" * 64)).mkdir()
    before = _files(toy.workspace)
    code, said = _fsck(toy, dry_run=True)
    assert code == 1 and len(said) == 3 and all("; would be set aside; " in line for line in said[:2])
    assert said[0].startswith(str(toy.store.entry("multiply", "0" * 64) / "record.json"))
    assert said[0].endswith("no run refers to it, so nothing else is to be done")
    assert _files(toy.workspace) == before and toy.store.entry("multiply", "0" * 64).is_dir()


def test_dangling_links_and_damaged_manifests_of_runs_are_named(toy: Any) -> None:
    toy.run("first")
    shutil.rmtree(_table(toy, "times", "one.00001").parent)
    (toy.workspace / "runs/first/total/manifest.json").write_text("{")
    code, said = _fsck(toy)
    times, total = (toy.workspace / "runs/first" / node for node in ("times", "total"))
    assert code == 1 and len(said) == 3
    assert said[0] == (
        f"{times}: 1 of its tables are no longer in the store, the first is numbers/one.00001.parquet; "
        f"made anew by: make toy (or remove {times.parent})"
    )
    assert said[1].startswith(f"{total}/manifest.json: it cannot be read (") and "what its run refers to" in said[1]
    toy.run("first")
    assert _fsck(toy)[0] == 0


def test_what_dead_processes_left_is_counted_and_is_no_damage(toy: Any) -> None:
    toy.run()
    dead = 2**22 + 1  # more than a Linux process can be
    for name in (f"multiply/.0123-{dead}-abcd", f"multiply/.4567-{os.getpid()}-abcd", ".damaged/multiply-0"):
        (toy.store.root / name).mkdir(parents=True)
        (toy.store.root / name / "blob").write_bytes(bytes(500_000))
    (toy.workspace / "scratch/multiply-0123").mkdir(parents=True)
    before = _files(toy.workspace)
    code, said = _fsck(toy)
    assert code == 0 and len(said) == 4 and _files(toy.workspace) == before
    assert [line.split(" (")[0] for line in said[:3]] == [
        "1 folders were set aside before",
        "1 folders were left half-made by processes that are not on this machine now",
        "1 folders are what long computations go on from",
    ]
    assert all(": 0.5 MB, such as " in line for line in said[:2])


def test_what_cannot_be_set_aside_is_said(toy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on SMB, where a folder with open files cannot be renamed."""
    toy.run()
    file = _table(toy, "total", "one")
    _rot(file)

    def rename(path: Path, target: Path) -> None:
        raise OSError(errno.EBUSY, "Device or resource busy")

    monkeypatch.setattr(Path, "rename", rename)
    code, said = _fsck(toy)
    assert code == 1 and file.exists()
    assert f"it could not be set aside (Device or resource busy), remove {file.parent} by hand" in said[0]


def test_what_another_run_made_anew_meanwhile_stays(toy: Any) -> None:
    toy.run()
    content, file = _table(toy, "total", "one").read_bytes(), _table(toy, "total", "one")
    _rot(file)
    found = checks(toy.store, toy.workspace / "synthetic")

    def look(place: Path, digest: Any) -> Any:
        flaws = original(place, digest)
        file.write_bytes(content)
        return flaws

    original = found[0].find_flaws
    assert [damage.place for damage in find_damage(found, 2, lambda num_bytes: None)] == [file.parent]
    assert list(find_damage([replace(check, find_flaws=look) for check in found], 1, lambda num_bytes: None)) == []


def test_all_bytes_are_counted_however_many_threads_there_are(toy: Any) -> None:
    for name in "abcdef":
        toy.record(name, 1, 2, 3, 4)
    toy.run()
    found, done = checks(toy.store, toy.workspace / "synthetic"), list[int]()
    assert list(find_damage(found, 4, done.append)) == []
    assert sum(done) == sum(path.stat().st_size for path in toy.store.root.glob("*/*/*")) > 0
    assert len(done) == len(found) == sum(1 for _ in toy.store.entries())


def test_who_interrupts_hears_what_was_found(toy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.run()
    file = _table(toy, "total", "one")
    _rot(file)

    def interrupted(found: Any, num_threads: int, advance: Any) -> Iterator[Damage]:
        yield from find_damage(found, num_threads, advance)
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.integrity.find_damage", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _fsck(toy)
    assert not file.exists() and len(list(toy.store.root.glob(".damaged/*"))) == 1


def test_files_are_read_with_the_cores_of_this_machine(toy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with those of workers elsewhere: fsck may run on the login node of a cluster."""
    seen: list[int] = []
    monkeypatch.setattr("pipeline.integrity.find_damage", lambda found, threads, advance: seen.append(threads) or [])
    monkeypatch.setattr("pipeline.integrity.num_cores", lambda: 3, raising=False)
    config = toy.config().model_copy(update={"executor": SimpleNamespace(name="slurm", num_workers=20, num_threads=4)})
    fsck(config, Console(quiet=True))
    assert seen == [3]


def test_what_is_suspect_is_set_aside_before_its_source(
    filmed: Path, toy: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    monkeypatch.setattr(Store, "set_aside", lambda store, folder, reason: order.append(folder.parent.name))
    _rot(next((filmed / "store/film").glob("*/a.mp4")))
    _check(filmed, toy)
    assert order == ["look", "film"]


def test_fsck_runs_beside_runs_and_not_beside_gc(toy: Any) -> None:
    toy.run()
    with _lock(toy.workspace, exclusive=False):
        assert execute("fsck", toy.config(), "") == 0
        with pytest.raises(UserError, match=r"a run is at work in .* \(or fsck\); try again when it has ended"):
            execute("gc", toy.config(), "")
    with (
        _lock(toy.workspace, exclusive=True),
        pytest.raises(UserError, match=r"gc is at work in .*; try again when it has ended"),
    ):
        execute("fsck", toy.config(), "")


def test_what_else_the_machine_refuses_is_not_said_to_be_gc(toy: Any) -> None:
    """As at the limit of processes, whose error has the number of a lock that is held."""
    with (
        pytest.raises(BlockingIOError, match="temporarily unavailable"),
        _lock(toy.workspace, exclusive=False),
    ):
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    with _lock(toy.workspace, exclusive=True):
        pass  # it was given back


def test_checking_all_the_time_never_makes_a_run_wrong(toy: Any) -> None:
    toy.run()
    has_ended = threading.Event()

    def check() -> None:
        while not has_ended.is_set():
            _fsck(toy)

    with ThreadPoolExecutor(1) as pool:
        checking = pool.submit(check)
        for number in range(8):
            for table in list(toy.store.root.glob("[!.]*/*/*.parquet"))[number % 3 :: 4]:
                with suppress(FileNotFoundError):
                    _rot(table)
            toy.run(f"run-{number}")  # may find that an entry vanished: then the next one makes it anew
        has_ended.set()
        checking.result()
    _fsck(toy)
    toy.run("last")
    assert toy.total("one") == 30 and _fsck(toy)[0] == 0


# --- files beside tables: a run sees their sizes only, so that what read a faded one may be wrong, too


@pytest.fixture
def filmed(tmp_path: Path) -> Path:
    """A workspace with a film in the store, a link to a file outside, what was made from them, and a recording."""
    import pyarrow as pa

    from assemblyhands_core.data.catalog import SOURCES

    workspace, outside = tmp_path / "work", tmp_path / "outside.mp4"
    outside.write_bytes(b"outside")
    FileDigests(tmp_path / "work" / "file-digests.json")(outside)
    store = Store(workspace)
    with store.draft("film", {"inputs": {}}) as draft:
        (draft.folder / "a.mp4").write_bytes(b"inside")
        (draft.folder / "b.mp4").symlink_to(outside)
        rows = [
            {"sequence_id": "one", "role": "video", "name": name, "source_file": name,
             "sha256": digest_file(draft.folder / name)}
            for name in ("a.mp4", "b.mp4")
        ]  # fmt: skip
        film = draft.write({"sources": (SOURCES, SOURCES.from_rows(rows))}, 1.0)
        path = draft.folder / "a.mp4"
        target = workspace / "synthetic/recordings/one/a.mp4"
        target.parent.mkdir(parents=True)
        target.hardlink_to(path)
    listing = workspace / "synthetic/delivered/one.sha256"
    listing.parent.mkdir()
    listing.write_text(f"# rig=desk\n{digest_file(target)}  recordings/one/a.mp4\n")
    for stage, read in (("look", f"{film.outputs['sources'].digest}#3"), ("other", "0" * 64)):
        with store.draft(stage, {"inputs": {"views": [read]}}) as draft:
            draft.write({"sources": (SOURCES, pa.Table.from_pylist([], SOURCES.schema))}, 1.0)
    return workspace


def _check(workspace: Path, toy: Any, **options: Any) -> tuple[int, list[str]]:
    toy.folder = workspace.parent
    assert toy.workspace == workspace
    return _fsck(toy, **options)


def _stages(workspace: Path) -> list[str]:
    return [path.parent.name for path in Store(workspace).entries()]


def test_films_links_and_recordings_are_read(filmed: Path, toy: Any) -> None:
    code, said = _check(filmed, toy)
    assert code == 0 and said[0].startswith("checked 4 entries and recordings")


def test_a_faded_film_takes_what_was_made_from_it_and_its_recording_along(filmed: Path, toy: Any) -> None:
    _rot(filmed / "synthetic/recordings/one/a.mp4")
    code, said = _check(filmed, toy, dry_run=True)
    assert code == 1 and _stages(filmed) == ["film", "look", "other"]
    code, said = _check(filmed, toy)
    assert code == 1 and _stages(filmed) == ["other"]
    assert [line.split(": ")[1].split(", perhaps")[0].rsplit("/", 1)[0] for line in said[:3]] == [
        "its contents have another sha256 than its table says; set aside; no run refers to it, so nothing else is to be"
        " done",
        f"its contents have another sha256 than {filmed / 'synthetic/delivered'}",
        "it was made from film",
    ]
    assert "the next run that needs this recording has it recorded again" in said[1]
    assert not (filmed / "synthetic/delivered/one.sha256").exists()


def test_a_lost_film_casts_no_doubt_on_what_was_made_from_it(filmed: Path, toy: Any) -> None:
    next((filmed / "store/film").glob("*/a.mp4")).unlink()
    assert _check(filmed, toy)[0] == 1
    assert _stages(filmed) == ["look", "other"]


def test_a_faded_file_outside_is_read_again_by_the_next_run(filmed: Path, toy: Any) -> None:
    outside = filmed.parent / "outside.mp4"
    remembered = FileDigests(filmed / "file-digests.json")(outside)
    _rot(outside)
    assert FileDigests(filmed / "file-digests.json")(outside) == remembered != digest_file(outside)
    code, said = _check(filmed, toy)
    assert code == 1 and f"(it is a link to {outside}); set aside; restore the file that the link leads to" in said[0]
    assert FileDigests(filmed / "file-digests.json")(outside) == digest_file(outside)


def test_a_server_that_is_away_makes_nothing_damaged(filmed: Path, monkeypatch: pytest.MonkeyPatch, toy: Any) -> None:
    def away(path: Path) -> str:
        raise OSError(errno.ESTALE, "Stale file handle")

    monkeypatch.setattr("pipeline.damage.digest_file", away)
    monkeypatch.setattr("assemblyhands_core.data.integrity.digest_file", away)
    code, said = _check(filmed, toy)
    assert code == 1 and _stages(filmed) == ["film", "look", "other"]
    assert said[0].endswith("it cannot be read (Stale file handle); see to it that it can be read, and check again")
    assert said[-1].endswith(": 0 damaged, 2 could not be read, 0 flaws in runs")
    assert (filmed / "synthetic/delivered/one.sha256").exists()


def test_only_what_read_a_faded_film_is_suspect(filmed: Path) -> None:
    store = Store(filmed)
    _rot(next((filmed / "store/film").glob("*/a.mp4")))
    found = list(find_damage(checks(store, filmed / "none"), 1, lambda num_bytes: None))
    assert [damage.place.parent.name for damage in found] == ["film"] and found[0].is_silent
    assert [damage.place.parent.name for damage in find_suspects(store, found)] == ["look"]
    assert list(find_suspects(store, [Damage(found[0].place, [])])) == []
    assert json.loads((found[0].place / "record.json").read_text())["blobs"] == {"a.mp4": 6, "b.mp4": 7}
