"""Dask's own scheduler and workers, as a user starts them, here or on hosts that are network namespaces."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from command_line import REPOSITORY

_START_S = 60.0
_DASK = str(Path(sys.executable).with_name("dask"))
# A host that is cut off is noticed after seconds instead of half a minute.
_IMPATIENT = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "12s", "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"}


@dataclass
class Cluster:
    """What was started of Dask, in the order in which it was.

    Attributes:
        folder: for its logs.
    """

    folder: Path
    processes: list["subprocess.Popen[bytes]"] = field(default_factory=list)

    def scheduler(self, address: str, *options: str, on: Sequence[str] = ()) -> "subprocess.Popen[bytes]":
        """Start a scheduler at ``tcp://IP:PORT`` and wait until it listens."""
        host, port = address.rpartition("/")[2].split(":")
        return self._start(
            [*on, _DASK, "scheduler", "--no-dashboard", "--host", host, "--port", port, *options], "Scheduler at:"
        )

    def worker(
        self, address: str, *options: str, on: Sequence[str] = (), ip: str = "127.0.0.1"
    ) -> "subprocess.Popen[bytes]":
        """Start a worker that takes one task at a time, and wait until the scheduler knows it."""
        arguments = [
            "worker",
            address,
            "--host",
            ip,
            "--no-dashboard",
            *(() if "--nthreads" in options else ("--nthreads", "1")),
        ]
        return self._start([*on, _DASK, *arguments, *options], "Registered to:")

    def _start(self, command: Sequence[str], sign: str) -> "subprocess.Popen[bytes]":
        log = self.folder / f"{len(self.processes)}.log"
        environment = {**os.environ, **_IMPATIENT, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
        with log.open("wb") as file:
            process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stderr=file, stdout=file, start_new_session=True
            )
        self.processes.append(process)
        deadline = time.monotonic() + _START_S
        while sign not in log.read_text():
            assert process.poll() is None and time.monotonic() < deadline, log.read_text()
            time.sleep(0.05)
        return process


@contextmanager
def cluster(folder: Path) -> Iterator[Cluster]:
    """Give a cluster to start, and end all of it."""
    folder.mkdir()
    started = Cluster(folder)
    try:
        yield started
    finally:
        for process in started.processes:
            kill(process)


def kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill a process with all that it has started."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(30)


@dataclass(frozen=True)
class Hosts:
    """Machines that are network namespaces, joined by a switch on the first of them.

    Attributes:
        ips: address of each, by name.
    """

    prefix: str
    ips: Mapping[str, str]

    def on(self, name: str) -> list[str]:
        """Return what makes a command run on a host."""
        return ["ip", "netns", "exec", self.prefix + name]

    def cut_off(self, name: str) -> None:
        """Pull a host's network cable: nobody is told, packets just vanish."""
        run("ip", "-n", self.prefix + name, "link", "set", "cable", "down")


@contextmanager
def hosts(*names: str) -> Iterator[Hosts]:
    """Give three or so hosts on one machine; the first has the switch.

    Raises:
        PermissionError: the machine does not let us.
    """
    found = Hosts(f"ah{os.getpid()}-", {name: f"10.77.0.{number}" for number, name in enumerate(names, 1)})
    first, *others = names
    try:
        for name in names:
            run("ip", "netns", "add", found.prefix + name)
            run("ip", "-n", found.prefix + name, "link", "set", "lo", "up")
        switch = found.prefix + first
        run("ip", "-n", switch, "link", "add", "switch", "type", "bridge")
        run("ip", "-n", switch, "addr", "add", f"{found.ips[first]}/24", "dev", "switch")
        run("ip", "-n", switch, "link", "set", "switch", "up")
        for number, name in enumerate(others):
            host, plug = found.prefix + name, f"plug{number}"
            run("ip", "-n", switch, "link", "add", plug, "type", "veth", "peer", "name", "cable", "netns", host)
            run("ip", "-n", switch, "link", "set", plug, "master", "switch", "up")
            run("ip", "-n", host, "addr", "add", f"{found.ips[name]}/24", "dev", "cable")
            run("ip", "-n", host, "link", "set", "cable", "up")
        yield found
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", found.prefix + name], capture_output=True, timeout=30)


def run(*command: str) -> None:
    """Run a command of the system.

    Raises:
        PermissionError: it is refused, or not there.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    except FileNotFoundError as error:
        raise PermissionError(f"{command[0]} is not installed") from error
    if done.returncode:
        raise PermissionError(f"{' '.join(command)}: {done.stderr.strip()}")
