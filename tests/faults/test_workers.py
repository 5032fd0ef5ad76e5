"""Workers that die again and again, runs side by side, and gc beside a run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import deadly_stages
import pytest
from command_line import REPOSITORY, TIMEOUT_S, digests, entries, finish, pipeline, start


@pytest.mark.slow
def test_a_shard_that_kills_its_worker_fails_alone(tmp_path: Path) -> None:
    path = os.pathsep.join([str(REPOSITORY), str(Path(deadly_stages.__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", f"import deadly_stages as d; d.main(d.Path({str(tmp_path / 'work')!r}))"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=TIMEOUT_S,
    )  # fmt: skip
    assert done.returncode == 0 and not done.stderr, done.stderr
    found = {(node, shard): (status, error) for node, shard, status, error in json.loads(done.stdout)}
    status, error = found.pop(("work", "one.00002"))
    assert status == "failed" and error.startswith("its worker was lost")
    assert found.pop(("gather", "one"))[0] == "blocked"
    # What a lost worker had finished is found in the store.
    assert set(found.values()) <= {("done", ""), ("reused", "")} and len(found) == 2 * (deadly_stages.NUM_CHUNKS + 1)


def test_two_runs_at_once_give_the_same(undisturbed: Any, tmp_path: Path) -> None:
    workspace = tmp_path / "work"
    runs = [start(*undisturbed.command, "executor.num_workers=1", workspace=workspace) for _ in range(2)]
    for run in runs:
        undisturbed.assert_same(workspace, finish(run))
    names = [path.name for path in (workspace / "runs").iterdir() if not path.is_symlink()]
    assert len(names) == 2
    assert all(digests(workspace, name) == undisturbed.digests for name in names)
    assert not list((workspace / "store").glob("*/.*"))


def test_gc_waits_for_no_run_but_refuses(undisturbed: Any, tmp_path: Path) -> None:
    workspace = tmp_path / "work"
    run = start(*undisturbed.command, "executor=serial", workspace=workspace)
    deadline = time.monotonic() + TIMEOUT_S
    while not entries(workspace) and time.monotonic() < deadline:
        time.sleep(0.01)
    run.send_signal(signal.SIGSTOP)  # however fast it is, it is not over before gc has looked
    refused = pipeline("gc", "gc.keep_runs=1", workspace=workspace)
    run.send_signal(signal.SIGCONT)
    undisturbed.assert_same(workspace, finish(run))
    refused.assert_refused(2, "error: a run is at work in", "try again when it has ended")


@pytest.mark.slow
def test_workers_without_memory_do_not_hang(undisturbed: Any, tmp_path: Path) -> None:
    limit = ["executor.num_workers=2", "executor.memory_limit=60MB"]
    outcome = pipeline(*undisturbed.command, *limit, workspace=tmp_path / "work")
    outcome.assert_refused(2, "worker processes have died", "raise executor.memory_limit")
