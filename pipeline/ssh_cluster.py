"""Workers on machines that are reached by ssh."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from pipeline.config import UserError
from pipeline.executor_config import SshConfig
from pipeline.remote_workers import NO_DASHBOARD
from pipeline.run_credentials import run_credentials, tls_settings

_IDLE: Final = "1 hour"
"""A scheduler whose run was killed ends itself, and its workers, when it had nothing to do for so long."""


@contextmanager
def ssh_cluster(config: SshConfig, workspace: Path) -> Iterator[Any]:
    """Give workers on each host; the scheduler is on the first.

    Raises:
        UserError: a package is missing, a host cannot be reached, or nothing starts there.
    """
    import dask
    from distributed import SSHCluster
    from distributed.security import Security

    if find_spec("asyncssh") is None:
        raise UserError("executor=ssh needs a package: .venv/bin/pip install -e '.[cluster]'")
    logging.getLogger("distributed.deploy.ssh").setLevel(logging.WARNING)
    # What ssh starts takes over this process's settings of Dask, and finds the certificate by them.
    with run_credentials(workspace) as folder, dask.config.set(tls_settings(folder)):
        try:
            cluster = SSHCluster(
                [config.hosts[0], *config.hosts],
                connect_options=_connect_options(config),
                worker_options={
                    "nthreads": 1,
                    "n_workers": config.num_workers,
                    "memory_limit": config.memory_limit,
                    **NO_DASHBOARD,
                },
                scheduler_options={"protocol": "tls://", "port": 0, "idle_timeout": _IDLE, **NO_DASHBOARD},
                remote_python=config.remote_python,
                security=Security(require_encryption=True),
            )
        except Exception as error:  # Dask raises a bare one for a worker that does not start
            reason, python = str(error).strip() or type(error).__name__, config.remote_python or sys.executable
            raise UserError(
                f"the workers on {', '.join(config.hosts)} do not start ({reason}); see whether ssh reaches each host "
                f"without a question, {python} runs there (executor.remote_python) and {workspace} is the same folder"
            ) from error
        with cluster:
            yield cluster


def _connect_options(config: SshConfig) -> dict[str, Any]:
    """Return what ssh is told; where nothing is said it looks into the user's own files."""
    known_hosts = None if config.known_hosts is None else str(config.known_hosts)
    options = {"port": config.port, "username": config.user, "known_hosts": known_hosts}
    return {name: value for name, value in options.items() if value is not None}
