"""Workers as jobs of Slurm."""

import logging
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.config import UserError
from pipeline.executor_config import SlurmConfig
from pipeline.remote_workers import GPU, NO_DASHBOARD
from pipeline.run_credentials import run_credentials, tls_settings


@contextmanager
def slurm_cluster(config: SlurmConfig, workspace: Path) -> Iterator[Any]:
    """Give jobs, each a worker that takes one task at a time; the scheduler is here.

    Raises:
        UserError: a package or Slurm is missing.
    """
    import dask
    from distributed.security import Security

    try:
        from dask_jobqueue import SLURMCluster
    except ImportError as error:
        raise UserError("executor=slurm needs a package: .venv/bin/pip install -e '.[cluster]'") from error
    if shutil.which("sbatch") is None:
        raise UserError("executor=slurm needs Slurm's `sbatch` on this machine: run it on the cluster's login node")
    logs = workspace / "logs" / "slurm"
    logs.mkdir(parents=True, exist_ok=True)
    with run_credentials(workspace) as folder, dask.config.set(tls_settings(folder)):
        cluster = SLURMCluster(
            **job_options(config),
            security=Security(require_encryption=True),
            shared_temp_directory=str(folder),
            log_directory=str(logs),
            scheduler_options=NO_DASHBOARD,
            silence_logs=logging.CRITICAL,
        )
        try:
            # Not `scale`: a job that ends, as its time is up or others come first, is to be followed by another one.
            cluster.adapt(minimum_jobs=config.num_workers, maximum_jobs=config.num_workers)
            yield cluster
        finally:
            cluster.close()


def job_options(config: SlurmConfig) -> dict[str, Any]:
    """Return what a job is, in the words of dask-jobqueue."""
    gpu_directives = [f"--gres=gpu:{config.gpus}"] if config.gpus else []
    gpu_offer = ["--resources", f"{GPU}=1"] if config.gpus else []
    unseen = ["--no-dashboard", "--dashboard-address", NO_DASHBOARD["dashboard_address"]]
    lifetime = ["--lifetime", config.lifetime, "--lifetime-stagger", config.lifetime_stagger]
    return {
        "queue": config.queue,
        "account": config.account,
        "cores": config.cores,
        "processes": 1,
        "memory": config.memory,
        "walltime": config.walltime,
        "interface": config.interface,
        "python": sys.executable,
        "job_name": "assemblyhands",
        "job_extra_directives": [*gpu_directives, *config.job_extra_directives],
        "job_script_prologue": list(config.job_script_prologue),
        "worker_extra_args": ["--nthreads", "1", *unseen, *lifetime, *gpu_offer],
    }
