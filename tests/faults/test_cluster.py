"""``executor=cluster``: a scheduler and workers that others have started."""

import signal
import socket
import ssl
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import TIMEOUT_S, entries, finish, pipeline, start
from dask_hosts import Cluster, cluster, kill


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Cluster]:
    with cluster(tmp_path / "dask") as found:
        yield found


def _address(protocol: str = "tcp") -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"{protocol}://127.0.0.1:{free.getsockname()[1]}"


def _executor(address: str) -> list[str]:
    return ["executor=cluster", f"executor.scheduler={address}"]


def test_a_cluster_gives_what_one_process_gives(undisturbed: Any, started: Cluster, tmp_path: Path) -> None:
    address, workspace = _address(), tmp_path / "work"
    refused = pipeline(*undisturbed.command, *_executor(address), "executor.wait_s=1", workspace=workspace)
    refused.assert_refused(2, f"error: there is no scheduler to be reached at {address}")
    started.scheduler(address)
    command = [*undisturbed.command, *_executor(address), "executor.wait_s=1"]
    refused = pipeline(*command, workspace=workspace)
    refused.assert_refused(2, f"error: the scheduler at {address} has had no worker for 1 s", "start workers")
    started.worker(address, "--nworkers", "2")
    undisturbed.assert_same(workspace, pipeline(*command, workspace=workspace))
    assert not list(workspace.glob("scratch/probe-*"))
    refused = pipeline(*command, "executor.needs_gpu=true", "triangulate.max_reprojection_px=9", workspace=workspace)
    refused.assert_refused(2, "error: no worker offers a GPU; start one with --resources GPU=1")


@pytest.mark.slow
def test_workers_that_cannot_do_the_work_are_named(undisturbed: Any, started: Cluster, tmp_path: Path) -> None:
    address = _address()
    started.scheduler(address)
    for options, sentence in (
        (["--nthreads", "2"], "takes 2 tasks at a time; start it with --nthreads 1"),
        (["--resources", "GPU=1"], "offers a GPU and sees none"),
    ):
        worker = started.worker(address, *options)
        refused = pipeline(*undisturbed.command, *_executor(address), workspace=tmp_path / "work")
        refused.assert_refused(2, "error: worker 127.0.0.1 (tcp://127.0.0.1:", sentence)
        kill(worker)


@pytest.mark.slow
def test_a_scheduler_that_freezes_ends_the_run(undisturbed: Any, started: Cluster, tmp_path: Path) -> None:
    """It keeps its connections and never answers, as a machine that swaps, or hangs in its network file system."""
    address, workspace = _address(), tmp_path / "work"
    scheduler = started.scheduler(address)
    started.worker(address)
    run = start(*undisturbed.command, *_executor(address), "executor.wait_s=5", workspace=workspace)
    deadline = time.monotonic() + TIMEOUT_S
    while not entries(workspace):
        assert time.monotonic() < deadline and run.poll() is None, "it has done nothing"
        time.sleep(0.02)
    scheduler.send_signal(signal.SIGSTOP)
    outcome = finish(run)
    outcome.assert_refused(2, f"error: the scheduler at {address} has not answered for 5 s; what was finished is kept")
    scheduler.send_signal(signal.SIGCONT)
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, *_executor(address), workspace=workspace))


@pytest.mark.slow
def test_tls_lets_in_who_has_a_certificate(undisturbed: Any, started: Cluster, tmp_path: Path) -> None:
    from distributed.security import Security

    made, pair = Security.temporary(), [tmp_path / "cert.pem", tmp_path / "key.pem"]
    for path, text in zip(pair, (made.tls_client_cert, made.tls_client_key), strict=True):
        path.write_text(text)
    files = [str(path) for path in (pair[0], *pair)]
    options = [
        word for name, path in zip(("ca-file", "cert", "key"), files, strict=True) for word in (f"--tls-{name}", path)
    ]
    address, workspace = _address("tls"), tmp_path / "work"
    started.scheduler(address, "--protocol", "tls", *options)
    started.worker(address, "--protocol", "tls", *options)
    stranger = ssl.create_default_context(cafile=files[0])  # it trusts the scheduler, and has nothing to be trusted by
    stranger.check_hostname = False
    with (
        socket.create_connection(tuple(address[6:].split(":")), timeout=TIMEOUT_S) as plain,  # type: ignore[arg-type]
        stranger.wrap_socket(plain) as encrypted,
        pytest.raises(ssl.SSLError, match=r"(?i)certificate.required"),
    ):
        encrypted.recv(1)
    plain_tcp = _executor(address.replace("tls", "tcp"))
    refused = pipeline(*undisturbed.command, *plain_tcp, workspace=workspace)
    refused.assert_refused(2, "error: there is no scheduler to be reached at tcp://")
    tls = [f"executor.tls.{name}={path}" for name, path in zip(("ca", "cert", "key"), files, strict=True)]
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, *_executor(address), *tls, workspace=workspace))
