import os
import shutil
from typing import Any

from pipeline.config import GcConfig
from pipeline.garbage import find_garbage


def _gc(toy: Any, keep_runs: int) -> Any:
    return find_garbage(toy.workspace, GcConfig(keep_runs=keep_runs, dry_run=False))


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


def test_what_a_killed_run_made_stays_for_the_next(toy: Any) -> None:
    toy.run("first")
    toy.factor = 3.0
    toy.run("second")
    (view,) = (toy.workspace / "runs").glob("second")
    shutil.rmtree(view)  # as if it had been killed before its view was written
    assert _gc(toy, 1).entries == []
