"""Schedulers that cannot be used are named, and not waited for."""

import socket
from pathlib import Path
from typing import Any

import pytest

from pipeline import remote_clusters
from pipeline.config import UserError
from pipeline.executor_config import ClusterConfig, SshConfig, TlsConfig
from pipeline.remote_clusters import remote_workers


def test_a_scheduler_that_takes_the_connection_and_never_answers_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_clusters, "_ANSWER_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as frozen:
        address = f"tcp://127.0.0.1:{frozen.getsockname()[1]}"
        shared = {"num_workers": 0, "num_threads": 1, "wait_s": 1.0, "needs_gpu": False}
        config = ClusterConfig(name="cluster", scheduler=address, tls=TlsConfig(ca=None, cert=None, key=None), **shared)
        sentence = f"there is no scheduler to be reached at {address}: it did not answer for 1 s"
        with pytest.raises(UserError, match=f"^{sentence}$"), remote_workers(config, tmp_path):
            pass


def test_a_worker_that_does_not_start_by_ssh_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: Any, **named: Any) -> None:
        raise Exception("Worker failed to start")  # in Dask's own words and type

    monkeypatch.setattr("distributed.SSHCluster", refuse)
    shared = {"num_workers": 1, "num_threads": 1, "wait_s": 1.0, "needs_gpu": False, "port": 22, "user": None}
    config = SshConfig(
        name="ssh", hosts=("alpha",), memory_limit="auto", remote_python="/no/python", known_hosts=None, **shared
    )
    sentence = (
        rf"^the workers on alpha do not start \(Worker failed to start\); .* /no/python runs there .*{tmp_path} is"
    )
    with pytest.raises(UserError, match=sentence), remote_workers(config, tmp_path):
        pass
