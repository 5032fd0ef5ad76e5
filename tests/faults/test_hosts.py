"""Several hosts, really: addresses of their own, cables that are pulled, workers and schedulers that die."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import TIMEOUT_S, entries, finish, start
from dask_hosts import Cluster, Hosts, cluster, hosts, kill

_NAMES = ("head", "alpha", "beta")


@pytest.fixture
def three() -> Iterator[Hosts]:
    context = hosts(*_NAMES)
    try:
        found = context.__enter__()
    except PermissionError as error:
        pytest.skip(f"hosts need root and network namespaces: {error}")
    try:
        yield found
    finally:
        context.__exit__(None, None, None)


@pytest.fixture
def started(tmp_path: Path, three: Hosts) -> Iterator[Cluster]:
    with cluster(tmp_path / "dask") as found:
        yield found


def _wait_for(workspace: Path, num_entries: int) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while len(entries(workspace)) < num_entries:
        assert time.monotonic() < deadline, f"{len(entries(workspace))} entries instead of {num_entries}"
        time.sleep(0.02)


def _wait_until_removed(started: Cluster, ip: str) -> None:
    """Wait until the scheduler, which was started first, has noticed that the workers of a host are gone."""
    log, deadline = started.folder / "0.log", time.monotonic() + TIMEOUT_S
    while f"Remove worker addr: tcp://{ip}:" not in log.read_text():
        assert time.monotonic() < deadline, f"nobody has noticed that {ip} is cut off"
        time.sleep(0.1)


@pytest.mark.slow
def test_a_host_may_be_cut_off(undisturbed: Any, three: Hosts, started: Cluster, tmp_path: Path) -> None:
    """The other one does its work, too, and the tables are those of one process."""
    address, workspace = f"tcp://{three.ips['head']}:8786", tmp_path / "work"
    command = [*undisturbed.command, "executor=cluster", f"executor.scheduler={address}", "executor.wait_s=60"]
    started.scheduler(address, on=three.on("head"))
    for name in ("alpha", "beta"):
        started.worker(address, on=three.on(name), ip=three.ips[name])
    run = start(*command, workspace=workspace, on=three.on("head"))
    _wait_for(workspace, 3)
    three.cut_off("alpha")
    undisturbed.assert_same(workspace, finish(run))
    _wait_until_removed(started, three.ips["alpha"])


@pytest.mark.slow
def test_hosts_may_be_cut_off_and_workers_and_schedulers_die(
    undisturbed: Any, three: Hosts, started: Cluster, tmp_path: Path
) -> None:
    """One host is cut off, a worker is killed, the scheduler is killed: the tables are those of one process."""
    address, workspace = f"tcp://{three.ips['head']}:8786", tmp_path / "work"
    command = [*undisturbed.command, "executor=cluster", f"executor.scheduler={address}", "executor.wait_s=60"]
    head, alpha, beta = (three.on(name) for name in _NAMES)

    scheduler = started.scheduler(address, on=head)
    workers = [
        started.worker(address, on=on, ip=three.ips[name])
        for name, on in (("alpha", alpha), ("beta", beta), ("beta", beta))
    ]
    run = start(*command, workspace=workspace, on=head)
    _wait_for(workspace, 1)
    three.cut_off("alpha")
    _wait_until_removed(started, three.ips["alpha"])
    _wait_for(workspace, 4)
    kill(workers[1])
    _wait_for(workspace, 8)
    assert run.poll() is None, "it ended before the scheduler could die"
    kill(scheduler)
    outcome = finish(run)
    outcome.assert_refused(2, f"error: the scheduler at {address} is gone; what was finished is kept")

    before = entries(workspace)
    started.scheduler(address, on=head)
    started.worker(address, on=beta, ip=three.ips["beta"])
    undisturbed.assert_same(workspace, finish(start(*command, workspace=workspace, on=head)))
    assert before and before.items() <= entries(workspace).items(), "something that was finished was made again"


@pytest.mark.slow
def test_a_workspace_that_is_not_shared_is_noticed(
    undisturbed: Any, three: Hosts, started: Cluster, tmp_path: Path
) -> None:
    address, workspace = f"tcp://{three.ips['head']}:8786", tmp_path / "work"
    workspace.mkdir()
    started.scheduler(address, on=three.on("head"))
    apart = ["unshare", "--mount", "sh", "-c", f'mount -t tmpfs none {workspace} && exec "$@"', "sh"]
    started.worker(address, on=[*three.on("alpha"), *apart], ip=three.ips["alpha"])
    command = [*undisturbed.command, "executor=cluster", f"executor.scheduler={address}"]
    outcome = finish(start(*command, workspace=workspace, on=three.on("head")))
    outcome.assert_refused(
        2, "error: worker 10.77.0.2 (tcp://10.77.0.2:", f"cannot write to {workspace}", "shared by all"
    )
