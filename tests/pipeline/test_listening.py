"""Nothing of a run on this machine can be reached from another one."""

import os
from typing import Any

import psutil

from pipeline.local_cluster import local_workers


def test_a_local_run_listens_on_loopback_alone() -> None:
    own = {address.port for address in _listening(psutil.Process(os.getpid()))}
    with local_workers(num_workers=1, num_threads=1, memory_limit="1GB"):
        me = psutil.Process(os.getpid())
        found = [address for process in (me, *me.children(recursive=True)) for address in _listening(process)]
    opened = [address for address in found if address.port not in own]
    assert len(opened) >= 2, "of the scheduler and of a worker"
    assert {address.ip for address in opened} == {"127.0.0.1"}


def _listening(process: psutil.Process) -> list[Any]:
    return [found.laddr for found in process.net_connections("inet") if found.status == psutil.CONN_LISTEN]
