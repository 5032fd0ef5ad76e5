"""The disk is full at each place where anything is written: never a wrong result, and the next run goes on."""

import shutil
from typing import Any

import pytest
from failing_files import failing_files

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.integrity import examine


def _make_room(toy: Any) -> None:
    shutil.rmtree(toy.workspace, ignore_errors=True)


def _write_points(toy: Any) -> list[str]:
    with failing_files(toy.workspace) as layer:
        toy.run()
    return layer.points


def _assert_nothing_is_wrong(toy: Any) -> None:
    """Check that whatever can be seen is whole."""
    for entry in toy.store.entries():
        assert not examine(entry, digest_file), entry
    runs = toy.workspace / "runs"
    for run in runs.glob("[!.]*"):
        assert (run / "run.json").is_file(), run


@pytest.mark.parametrize("stays_full", [True, False], ids=["stays full", "fails once"])
def test_a_full_disk_is_never_a_wrong_result(toy: Any, stays_full: bool) -> None:
    points = _write_points(toy)
    assert {"parquet begins numbers.parquet", "open record.json", "os.rename run"} <= set(points), points
    wanted = toy.total("one")
    told = 0
    for first in range(len(points)):
        _make_room(toy)
        with failing_files(toy.workspace, first, len(points) if stays_full else first):
            try:
                found = toy.run()
            except OSError as error:
                assert error.errno is not None and error.filename, "a sentence names the file"
                told += 1
            else:
                told += not all(result.has_entry for result in found)
        _assert_nothing_is_wrong(toy)
        assert all(result.has_entry for result in toy.run()), f"{points[first]}: not healed"
        assert toy.total("one") == wanted == 2.0 * (1 + 2 + 3 + 4 + 5)
        _assert_nothing_is_wrong(toy)
    # What is not told is what nobody misses: logs, and what is remembered to be quicker.
    assert told >= 0.8 * len(points), f"{told} of {len(points)}"
