import os
import shutil
import time
from pathlib import Path
from typing import Any

from pipeline.config import GcConfig
from pipeline.garbage import find_garbage
from pipeline.tasks import scratch_folder


def _gc(toy: Any, keep_runs: int, keep_scratch_days: float = 30) -> Any:
    config = GcConfig(keep_runs=keep_runs, keep_scratch_days=keep_scratch_days, dry_run=False)
    return find_garbage(toy.workspace, config)


def test_what_a_kept_run_refers_to_stays(toy: Any) -> None:
    toy.run()
    garbage = _gc(toy, 1)
    assert garbage.runs == garbage.entries == garbage.leftovers == []


def test_old_runs_and_what_only_they_refer_to_go(toy: Any) -> None:
    toy.run("first")
    toy.factor = 3.0
    toy.run("second")
    os.utime(toy.workspace / "runs/first/run.json", ns=(0, 0))
    assert _gc(toy, 2).entries == []
    garbage = _gc(toy, 1)
    assert [path.name for path in garbage.runs] == ["first"]
    assert [path.parent.name for path in garbage.entries] == ["multiply", "multiply", "sum"]
    assert garbage.num_bytes > 0
    garbage.remove()
    assert set(toy.status(toy.run("third")).values()) == {"reused"}
    assert toy.total("one") == 45


def test_leftovers_of_killed_runs_go(toy: Any) -> None:
    toy.run()
    left = toy.store.root / "multiply" / ".0123-99-abcd"
    draft = toy.workspace / "runs" / ".second-99"
    log = toy.workspace / "logs" / "killed"
    for folder in (left, draft, log):
        folder.mkdir()
    garbage = _gc(toy, 1)
    assert garbage.leftovers == [left, draft] and garbage.logs == [log] and garbage.entries == garbage.runs == []


def test_old_certificates_of_killed_runs_go(toy: Any) -> None:
    toy.run()
    old, new = (toy.workspace / "tls" / name for name in ("old", "new"))
    for folder, days_ago in ((old, 31), (new, 29)):
        folder.mkdir(parents=True)
        (folder / "key.pem").write_text("secret")
        for path in (folder / "key.pem", folder):
            os.utime(path, (time.time() - days_ago * 86400,) * 2)
    garbage = _gc(toy, 1)
    assert garbage.leftovers == [old]
    garbage.remove()
    assert not old.exists() and new.is_dir()


def test_what_a_killed_run_made_stays_for_the_next(toy: Any) -> None:
    toy.run("first")
    toy.factor = 3.0
    toy.run("second")
    (view,) = (toy.workspace / "runs").glob("second")
    shutil.rmtree(view)  # as if it had been killed before its view was written
    assert _gc(toy, 1).entries == []


def _scratch(toy: Any, stage: str, key: str, days_ago: float) -> Path:
    """Make what an interrupted computation would go on from."""
    folder = scratch_folder(toy.workspace, stage, key)
    folder.mkdir(parents=True)
    (folder / "checkpoint").write_bytes(b"half")
    changed_s = time.time() - days_ago * 86400
    for path in (folder / "checkpoint", folder):
        os.utime(path, (changed_s, changed_s))
    return folder


def test_scratch_goes_once_its_result_is_there(toy: Any) -> None:
    key = toy.run()[0].key
    done, running = _scratch(toy, "cut", key, 0), _scratch(toy, "cut", "0" * 64, 0)
    garbage = _gc(toy, 1)
    assert garbage.scratch == [done]
    garbage.remove()
    assert running.is_dir() and not done.exists() and toy.store.find("cut", key) is not None


def test_scratch_that_nobody_went_on_with_for_long_goes(toy: Any) -> None:
    toy.run()
    old, new = _scratch(toy, "multiply", "0" * 64, 31), _scratch(toy, "multiply", "1" * 64, 29)
    assert _gc(toy, 1).scratch == [old]
    assert _gc(toy, 1, keep_scratch_days=28).scratch == [old, new]
    (old / "checkpoint").write_bytes(b"more")  # written within an old folder
    assert _gc(toy, 1).scratch == []


def test_old_scratch_stays_while_a_kept_run_lacks_its_result(toy: Any) -> None:
    result = toy.run()[0]
    scratch = _scratch(toy, "cut", result.key, 31)
    toy.store.set_aside(toy.store.entry("cut", result.key), "faded")
    assert _gc(toy, 1).scratch == []
    shutil.rmtree(toy.workspace / "runs")
    assert _gc(toy, 1).scratch == [scratch]


def test_what_vanishes_meanwhile_is_no_error(toy: Any) -> None:
    folders = [_scratch(toy, "multiply", digit * 64, 31) for digit in "01"]
    garbage = _gc(toy, 1)
    shutil.rmtree(folders[0])
    garbage.remove()
    assert not folders[1].exists()
