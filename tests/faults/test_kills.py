"""``kill -9`` of the main process, or of a worker, at any point: the same command again finishes with the same results.

A trial kills when the store holds a given number of entries and some time has passed since, both drawn from a seed, so
that the points spread over the whole run however fast the machine is.
"""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import Popen
from typing import Any

import numpy as np
import psutil  # type: ignore[import-untyped]
import pytest
from command_line import TIMEOUT_S, Outcome, entries, finish, pipeline, start

NUM_ENTRIES = 20  # of the undisturbed run
NUM_TRIALS = 24
ORPHANS_DIE_WITHIN_S = 15.0
Disturb = Callable[["Popen[str]"], None]


def _workers(process: "Popen[str]") -> list[psutil.Process]:
    """Return the processes that run tasks: not the one that cleans up shared memory after them."""
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(_command(child))]


def _command(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except psutil.Error:
        return []


def _run_and_disturb(
    command: list[str], workspace: Path, num_entries: int, pause_s: float, disturb: Disturb
) -> tuple[Outcome, bool]:
    """Start a command, disturb it when so many entries are there; return its end and whether it came to that."""
    process = start(*command, "executor.num_workers=2", workspace=workspace)
    deadline = time.monotonic() + TIMEOUT_S
    while len(entries(workspace)) < num_entries and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(pause_s)
    is_running = process.poll() is None
    if is_running:
        disturb(process)
    return finish(process), is_running


def _kill_main(process: "Popen[str]") -> None:
    workers = _workers(process)
    process.send_signal(signal.SIGKILL)
    _, alive = psutil.wait_procs(workers, timeout=ORPHANS_DIE_WITHIN_S)
    for worker in alive:
        worker.kill()
    assert not alive, f"workers live on without the main process: {alive}"


def _kill_worker(generator: np.random.Generator) -> Disturb:
    def kill(process: "Popen[str]") -> None:
        while process.poll() is None:
            if workers := _workers(process):
                workers[int(generator.integers(len(workers)))].kill()
                return
            time.sleep(0.01)

    return kill


def _trial(seed: int, undisturbed: Any, workspace: Path, assert_clean: Callable[[Path], None]) -> None:
    generator = np.random.default_rng(seed)
    num_entries, pause_s = int(generator.integers(NUM_ENTRIES)), float(generator.uniform(0, 0.3))
    if seed % 2:
        outcome, came_to_it = _run_and_disturb(undisturbed.command, workspace, num_entries, pause_s, _kill_main)
        assert outcome.code == (-signal.SIGKILL if came_to_it else 0)
    else:
        worker = _kill_worker(generator)
        outcome, _ = _run_and_disturb(undisturbed.command, workspace, num_entries, pause_s, worker)
        undisturbed.assert_same(workspace, outcome)  # the same run heals: a lost worker's shards are done by another
    before = entries(workspace)
    executor = "executor.num_workers=2" if seed % 4 < 2 else "executor=serial"
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, executor, workspace=workspace))
    assert before.items() <= entries(workspace).items(), "something that was finished was made again"
    assert_clean(workspace)


@pytest.mark.parametrize("seed", [2, 3])
def test_a_kill_loses_nothing(seed: int, undisturbed: Any, tmp_path: Path, assert_clean: Any) -> None:
    _trial(1000 + seed, undisturbed, tmp_path / "work", assert_clean)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(NUM_TRIALS))
def test_kills_at_random_points(seed: int, undisturbed: Any, tmp_path: Path, assert_clean: Any) -> None:
    _trial(seed, undisturbed, tmp_path / "work", assert_clean)


@pytest.mark.slow
def test_kill_after_kill_comes_to_an_end(undisturbed: Any, tmp_path: Path, assert_clean: Any) -> None:
    """Killed again and again, always when a few more entries are there, each run goes on where the last one ended."""
    workspace, generator = tmp_path / "work", np.random.default_rng(7)
    for num_entries in range(2, NUM_ENTRIES, 3):
        before = entries(workspace)
        _run_and_disturb(undisturbed.command, workspace, num_entries, float(generator.uniform(0, 0.1)), _kill_main)
        assert before.items() <= entries(workspace).items()
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, "executor.num_workers=2", workspace=workspace))
    assert_clean(workspace)


def test_an_interrupt_says_that_nothing_is_lost(undisturbed: Any, tmp_path: Path) -> None:
    """Ctrl-C reaches all processes of the terminal's group."""

    def interrupt(process: "Popen[str]") -> None:
        for member in [psutil.Process(process.pid), *_workers(process)]:
            member.send_signal(signal.SIGINT)

    outcome, _ = _run_and_disturb(undisturbed.command, tmp_path / "work", 4, 0.0, interrupt)
    outcome.assert_refused(130, "interrupted", "what was finished is kept")
    assert len(outcome.err.splitlines()) == 1, outcome.err
