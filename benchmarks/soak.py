"""Annotation without end while workers are killed: does memory grow, does anything hang, get lost or doubled?

    python benchmarks/soak.py --calibration FILE --videos 'GLOB' [--minutes 60] [--workers 2] [--kill-every 150]

A scheduler and workers on the loopback interface live through the whole time; one run after the other annotates the
recording from nothing in a workspace of its own (`executor=cluster`). Every few minutes a worker that is chosen by
chance is killed; the first worker never is, so that its memory is seen over the whole time. The tables of every run are
compared with those of a run in one process that nothing disturbed. Memory is that of workers' processes at the ends of
runs; its slope is fitted over each process's life.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import numpy as np

_TIMEOUT_S = 1200
_PORT = 8797


def _pipeline(arguments: list[str], workspace: Path, *more: str) -> str:
    """Annotate; return what was said if it went wrong."""
    command = [sys.executable, "-m", "pipeline", "annotate", *arguments, *more, f"workspace={workspace}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"hangs after {_TIMEOUT_S} s"
    return "" if done.returncode == 0 else f"exit code {done.returncode}: {(done.stdout + done.stderr)[-2000:]}"


def _digests(workspace: Path) -> dict[str, str]:
    found: dict[str, str] = json.loads((workspace / "runs" / "latest" / "run.json").read_text())["digests"]
    return found


def _start(*arguments: str) -> "subprocess.Popen[bytes]":
    dask = Path(sys.executable).with_name("dask")
    return subprocess.Popen([dask, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _children(pid: int) -> list[int]:
    """Return the processes that a process has started, and those that these have."""
    found: list[int] = []
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                found += [int(child), *_children(int(child))]
    return found


def _resident_mb(pid: int) -> float:
    with suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096 / 1e6
    return 0.0


def _workers(nanny: int, least_mb: float = 80.0) -> list[int]:
    """Return the processes below a nanny that do the work: the large ones."""
    return [pid for pid in _children(nanny) if _resident_mb(pid) > least_mb]


class Killer(threading.Thread):
    """Kills a worker by chance, again and again."""

    def __init__(self, nannies: list[int], every_s: float) -> None:
        super().__init__(daemon=True)
        self.nannies, self.every_s, self.num_killed, self.is_over = nannies, every_s, 0, threading.Event()

    def run(self) -> None:
        """Kill until it is over."""
        chance = random.Random(0)
        while not self.is_over.wait(chance.uniform(0.5, 1.5) * self.every_s):
            if found := _workers(chance.choice(self.nannies)):
                with suppress(ProcessLookupError):
                    _kill(chance.choice(found))
                    self.num_killed += 1


def _kill(pid: int) -> None:
    """Kill a process by a descriptor, so that it is never another one that has taken over the number."""
    descriptor = os.pidfd_open(pid)
    try:
        signal.pidfd_send_signal(descriptor, signal.SIGKILL)
    finally:
        os.close(descriptor)


def _print_slopes(samples: dict[int, list[tuple[float, float]]]) -> None:
    for pid, points in samples.items():
        if len(points) < 4:
            continue
        minutes, megabytes = np.array(points).T
        slope = np.polyfit(minutes[1:], megabytes[1:], 1)[0]  # the first run loads what stays
        after = (
            f"{megabytes[0]:.0f} MB after the first, {megabytes[-1]:.0f} after the last, at most {megabytes.max():.0f}"
        )
        life = f"{len(points)} runs in {minutes[-1] - minutes[0]:.0f} min"
        print(f"worker {pid}: {life}, {after}; slope {slope:+.2f} MB a minute")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibration", required=True)
    parser.add_argument("--videos", required=True)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2, help="at least 2: the first is never killed")
    parser.add_argument("--kill-every", type=float, default=150)
    parser.add_argument("parameters", nargs="*", help="further parameters of the runs")
    options = parser.parse_args()
    if options.workers < 2:
        parser.error("--workers has to be at least 2: the first is never killed")
    folder = Path(tempfile.mkdtemp(prefix="soak-"))
    recording = [
        "seq=soak",
        f"rig.calibration={options.calibration}",
        f"rig.videos={options.videos}",
        *options.parameters,
    ]
    address = f"tcp://127.0.0.1:{_PORT}"

    problem = _pipeline(recording, folder / "undisturbed", "executor=serial")
    assert not problem, problem
    wanted = _digests(folder / "undisturbed")
    unseen = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    processes = [_start("scheduler", "--host", "127.0.0.1", "--port", str(_PORT), *unseen)]
    time.sleep(5)
    processes += [
        _start("worker", address, "--host", "127.0.0.1", "--nthreads", "1", *unseen) for _ in range(options.workers)
    ]
    _, _, *mortal = (process.pid for process in processes)  # the first worker lives on, to see whether it grows
    killer = Killer(mortal, options.kill_every)
    killer.start()
    begin, num_runs, num_bad = time.monotonic(), 0, 0
    samples: dict[int, list[tuple[float, float]]] = defaultdict(list)
    try:
        while (now := time.monotonic() - begin) < 60 * options.minutes:
            workspace = folder / "work"
            problem = _pipeline(recording, workspace, "executor=cluster", f"executor.scheduler={address}")
            num_runs += 1
            if problem or _digests(workspace) != wanted:
                num_bad += 1
                print(f"run {num_runs}: {problem or 'other tables'}", flush=True)
            for process in processes[1:]:
                for pid in _workers(process.pid):
                    samples[pid].append(((time.monotonic() - begin) / 60, _resident_mb(pid)))
            shutil.rmtree(workspace, ignore_errors=True)
            so_far = f"{num_runs} runs, {killer.num_killed} workers killed, {num_bad} runs wrong"
            memory = ", ".join(f"{_resident_mb(pid):.0f} MB ({pid})" for n in processes[1:] for pid in _workers(n.pid))
            print(f"{now / 60:.0f} min: {so_far}; workers have {memory}", flush=True)
    finally:
        killer.is_over.set()
        for process in processes:
            process.terminate()
    print(f"{num_runs} runs, {killer.num_killed} workers killed, {num_bad} runs that were wrong, failed or hung")
    _print_slopes(samples)
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
