"""Schedulers that cannot be used are named, and not waited for."""

import socket
from pathlib import Path

import pytest

from pipeline import remote_clusters
from pipeline.config import UserError
from pipeline.executor_config import ClusterConfig, TlsConfig
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
