"""Damaged entries of the store: found, set aside and made anew by the same command, with the same contents.

Every file of an entry is named: a table, a blob or the record. A flipped byte leaves its size alone; it is found when a
stage reads the table, or because the file is newer than its record, so that nobody is handed it as a result.
"""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from command_line import entries, new_stages, pipeline

from assemblyhands_core.data.store import load

Damage = Callable[[Path], None]


def _truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-7])


def _empty(file: Path) -> None:
    file.write_bytes(b"")


def _remove(file: Path) -> None:
    file.unlink()


def _flip(file: Path, place: int | None = None) -> None:
    """Flip a bit of the first data page, behind Parquet's magic bytes and the page's header."""
    content = bytearray(file.read_bytes())
    content[len(content) // 3 if place is None else place] ^= 0x10
    file.write_bytes(bytes(content))


def _flip_the_end(file: Path) -> None:
    """Flip a bit of Parquet's footer."""
    content = bytearray(file.read_bytes())
    content[-40] ^= 0x10
    file.write_bytes(bytes(content))


def _cut_record(file: Path) -> None:
    record = file.parent / "record.json"
    record.write_bytes(record.read_bytes()[:100])


def _remove_record(file: Path) -> None:
    (file.parent / "record.json").unlink()


def _remove_entry(file: Path) -> None:
    shutil.rmtree(file.parent)


TABLES = {
    "ingest": "chunks", "undistort": "rectified_views", "detect_hands": "hand_boxes", "crop_hands": "crops",
    "detect_keypoints": "keypoints", "round_0": "joints", "quality": "quality", "overlay": "overlays",
}  # fmt: skip
DAMAGES: list[Damage] = [
    _truncate, _empty, _remove, _flip, _flip_the_end, _cut_record, _remove_record, _remove_entry,
]  # fmt: skip


def _file(workspace: Path, node: str, chunk: int = 1) -> Path:
    """Return the file of a node's table in the store, of one chunk where it has several."""
    folder = workspace / "runs" / "latest" / node / TABLES[node]
    files = [path.resolve() for path in sorted(folder.iterdir())]
    return files[chunk % len(files)]


def _heal_and_check(undisturbed: Any, workspace: Path, assert_clean: Callable[[Path], None]) -> None:
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, "executor=serial", workspace=workspace))
    assert_clean(workspace)


@pytest.mark.parametrize("shift", [0, *(pytest.param(shift, marks=pytest.mark.slow) for shift in (1, 3, 5, 6))])
def test_damage_everywhere_is_healed(shift: int, undisturbed: Any, finished: Path, assert_clean: Any) -> None:
    """Damage one entry of every node at once, each in another way."""
    for number, file in enumerate([_file(finished, node, chunk=shift + i) for i, node in enumerate(TABLES)]):
        DAMAGES[(number + shift) % len(DAMAGES)](file)
    _heal_and_check(undisturbed, finished, assert_clean)


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("node", TABLES)
def test_each_damage_is_healed(node: str, damage: Damage, undisturbed: Any, finished: Path, assert_clean: Any) -> None:
    damage(_file(finished, node))
    _heal_and_check(undisturbed, finished, assert_clean)


def test_a_damaged_last_result_is_not_handed_out(undisturbed: Any, finished: Path, assert_clean: Any) -> None:
    """All that would read it is there already, so nobody but the run itself can notice."""
    file = _file(finished, "round_0")
    _flip(file)
    with pytest.raises(OSError, match=r"parquet cannot be read .*; run the command that made it again"):
        load(file)
    before = entries(finished)
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert new_stages(finished, before) == {"triangulate": 1}


def _rot(file: Path, place: int | None = None) -> None:
    """Flip a bit as an ageing disk does, which changes no time."""
    times = file.stat()
    _flip(file, place)
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))


def _last_of_first_column(table: Path) -> int:
    """Return where the last byte of the first column's values is, however small the table is."""
    column = pq.read_metadata(table).row_group(0).column(0)
    first = column.dictionary_page_offset if column.has_dictionary_page else column.data_page_offset
    return int(first + column.total_compressed_size - 1)


@pytest.mark.slow
def test_bit_rot_is_found_by_whoever_reads(undisturbed: Any, finished: Path, assert_clean: Any) -> None:
    lost = [_file(finished, "crop_hands", 1), _file(finished, "detect_keypoints", 2), _file(finished, "round_0", 3)]
    read = [
        _file(finished, "detect_hands", 1),
        _file(finished, "crop_hands", 2),
        _file(finished, "detect_keypoints", 3),
    ]
    for file in [_file(finished, "ingest"), _file(finished, "undistort"), *read]:
        _rot(file)
    for file in lost:  # so that what is before them is read
        _remove_entry(file)
    _heal_and_check(undisturbed, finished, assert_clean)


def test_bit_rot_that_nobody_reads_is_found_by_fsck(undisturbed: Any, finished: Path, assert_clean: Any) -> None:
    """Tables and a picture fade while their sizes and times stay: a run would reuse them as they are."""
    tables = [_file(finished, node) for node in TABLES if node != "overlay"]
    picture = next((finished / "store/draw_overlays").glob("*/*.png"))
    for table in tables:
        _rot(table, _last_of_first_column(table))
    _rot(picture)
    faded = [*tables, picture]
    before = entries(finished)
    would = pipeline("fsck", "fsck.dry_run=true", workspace=finished)
    assert would.code == 1 and all(f"{file}: it" in would.said for file in faded) and entries(finished) == before
    assert pipeline("fsck", workspace=finished).code == 1
    assert not any(file.exists() for file in faded)
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert pipeline("fsck", workspace=finished).assert_done().said.rstrip().endswith(": whole")
    assert_clean(finished)


@pytest.mark.slow
def test_a_lost_picture_is_drawn_again(undisturbed: Any, finished: Path) -> None:
    for picture in (finished / "store" / "draw_overlays").glob("*/*.png"):
        picture.unlink()
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert all(Path(path).is_file() for path in load(finished / "runs" / "latest" / "overlay").overlay_file)


@pytest.mark.slow
def test_what_reads_a_healed_entry_is_reused(undisturbed: Any, finished: Path) -> None:
    """The first chunk is made anew after the others were found: order must not count."""
    _remove_entry(_file(finished, "round_0", chunk=0))
    before = entries(finished)
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert new_stages(finished, before) == {"triangulate": 1}


@pytest.mark.slow
def test_damaged_memories_do_no_harm(undisturbed: Any, finished: Path) -> None:
    """What the engine only remembers may be lost: it is worked out again."""
    (finished / "file-digests.json").write_text('{"half')
    manifest = next((finished / "runs").glob("[!l]*/round_0/manifest.json"))
    manifest.write_text("")
    next((finished / "runs").glob("[!l]*/run.json")).write_text("[")
    before = entries(finished)
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert new_stages(finished, before) == {}
    # gc would remove what only that run needs: it asks first.
    pipeline("gc", workspace=finished).assert_refused(2, str(manifest), "is damaged", "remove")
    assert entries(finished) == before


@pytest.mark.slow
def test_gc_keeps_the_latest_result_however_often_the_recording_was_looked_at(undisturbed: Any, finished: Path) -> None:
    command = [*undisturbed.command[1:], "executor=serial"]
    pipeline("doctor", *command, workspace=finished).assert_done()
    pipeline("gc", "gc.keep_runs=1", workspace=finished).assert_done()
    assert len(list((finished / "runs").glob("[!l]*"))) == 2
    before = entries(finished)
    undisturbed.assert_same(finished, pipeline("annotate", *command, workspace=finished))
    assert new_stages(finished, before) == {}


@pytest.mark.slow
def test_a_copied_workspace_is_whole_though_its_times_are_new(undisturbed: Any, finished: Path) -> None:
    for table in (finished / "store").glob("*/*/*.parquet"):
        table.touch()
    before = entries(finished)
    undisturbed.assert_same(finished, pipeline(*undisturbed.command, "executor=serial", workspace=finished))
    assert new_stages(finished, before) == {}
