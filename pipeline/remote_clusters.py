"""Dask clusters beyond this machine: one that runs already, jobs of Slurm, machines reached by ssh.

Whoever can reach a scheduler or worker of Dask can run programs on it, so everything that is started here asks for a
certificate, which is made for the run.
"""

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from pipeline.config import UserError
from pipeline.executor_config import ClusterConfig, RemoteConfig, SlurmConfig, TlsConfig
from pipeline.remote_workers import RemoteWorkers
from pipeline.slurm_cluster import slurm_cluster
from pipeline.ssh_cluster import ssh_cluster

_CONNECT_S: Final = 30.0
_ANSWER_S: Final = _CONNECT_S + 5.0  # connecting may take the former by itself


@contextmanager
def remote_workers(config: RemoteConfig, workspace: Path) -> Iterator[RemoteWorkers]:
    """Give the workers of the cluster that the configuration names, once the first is there; end what was started.

    Raises:
        UserError: the scheduler cannot be reached, a package is missing, or no worker comes.
    """
    with _client(config, workspace) as client:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # a lost worker is our own sentence
        problem = client.cluster.submissions.problem if isinstance(config, SlurmConfig) else str
        workers = RemoteWorkers(client, client.scheduler.address, config.num_workers_at_most, config.wait_s, problem)
        workers.wait()
        yield workers


@contextmanager
def _client(config: RemoteConfig, workspace: Path) -> Iterator[Any]:
    from distributed import Client

    if isinstance(config, ClusterConfig):
        with _connected(config) as client:
            yield client
        return
    started = slurm_cluster(config, workspace) if isinstance(config, SlurmConfig) else ssh_cluster(config, workspace)
    with started as cluster, Client(cluster, security=cluster.security, set_as_default=False) as client:
        yield client


@contextmanager
def _connected(config: ClusterConfig) -> Iterator[Any]:
    from distributed import Client

    assert config.scheduler is not None
    security = _security(config.tls) if config.scheduler.startswith("tls") else None
    try:
        asyncio.run(asyncio.wait_for(_identity(config.scheduler, security), _ANSWER_S))
        client = Client(config.scheduler, security=security, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = str(error.__cause__ or error).strip() or f"it did not answer for {_ANSWER_S:.0f} s"
        raise UserError(f"there is no scheduler to be reached at {config.scheduler}: {reason}") from error
    try:
        yield client
    finally:
        client.close(timeout=_CONNECT_S)


async def _identity(address: str, security: Any) -> Any:
    """Return what a scheduler says of itself; Dask's client would wait for ever for one that is frozen."""
    from distributed.core import rpc

    async with rpc(address, connection_args=security.get_connection_args("client") if security else {}) as scheduler:
        return await scheduler.identity()


def _security(tls: TlsConfig) -> Any:
    from distributed.security import Security

    files = {"ca": tls.ca, "cert": tls.cert, "key": tls.key}
    for name, path in files.items():
        if path is None or not path.is_file():
            raise UserError(f"executor.tls.{name}={path} is no file")
    return Security(
        tls_ca_file=str(tls.ca), tls_client_cert=str(tls.cert), tls_client_key=str(tls.key), require_encryption=True
    )
