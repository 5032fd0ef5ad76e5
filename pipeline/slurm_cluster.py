"""Workers as jobs of Slurm."""

import asyncio
import logging
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pipeline.config import UserError
from pipeline.executor_config import SlurmConfig
from pipeline.remote_workers import GPU, NO_DASHBOARD
from pipeline.run_credentials import run_credentials, tls_settings

_AGAIN_S: Final = 60.0
"""After so long a job that was refused is submitted again: limits of a queue, or Slurm itself, come and go."""


@dataclass
class Submissions:
    """What Slurm has said of the jobs of a run.

    Attributes:
        refusal: why it refused the last one; empty if it took it.
        has_taken: whether it took any.
        is_over: nothing more is to be submitted.
    """

    refusal: str = ""
    has_taken: bool = False
    is_over: bool = False

    def problem(self) -> str:
        """Return why there will be no worker, empty while one may come."""
        if self.has_taken or not self.refusal:
            return ""
        return (
            f"Slurm refuses the jobs of this run: {self.refusal}; set executor.queue, account, cores, memory, walltime "
            "and job_extra_directives to what `sbatch` takes here"
        )


@contextmanager
def slurm_cluster(config: SlurmConfig, workspace: Path) -> Iterator[Any]:
    """Give jobs, each a worker that takes one task at a time; the scheduler is here.

    Raises:
        UserError: a package or Slurm is missing, or jobs are described by what cannot be.
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
        submissions = Submissions()
        try:
            cluster = SLURMCluster(
                **job_options(config),
                job_cls=_job_type(submissions),
                security=Security(require_encryption=True),
                shared_temp_directory=str(folder),
                log_directory=str(logs),
                scheduler_options=NO_DASHBOARD,
                silence_logs=logging.CRITICAL,
            )
        except (ValueError, RuntimeError, OSError) as error:
            raise UserError(
                f"no job can be made of executor.memory={config.memory} and executor.interface={config.interface} "
                f"({str(error).strip()}); see conf/executor/slurm.yaml"
            ) from error
        cluster.submissions = submissions
        try:
            # Not `scale`: a job that ends, as its time is up or others come first, is to be followed by another one.
            cluster.adapt(minimum_jobs=config.num_workers, maximum_jobs=config.num_workers)
            yield cluster
        finally:
            submissions.is_over = True
            cluster.close()


def _job_type(submissions: Submissions) -> type[Any]:
    """Return dask-jobqueue's job, which by itself would be silent about a refusal and never submit again."""
    from dask_jobqueue.slurm import SLURMJob

    class Job(SLURMJob):  # type: ignore[misc]
        async def _submit_job(self, script_filename: str) -> str:
            while True:
                try:
                    said: str = await super()._submit_job(script_filename)
                except RuntimeError as error:
                    submissions.refusal = " ".join(str(error).partition("stderr:")[2].split()) or str(error)
                    await _pause(submissions)
                    if submissions.is_over:
                        raise asyncio.CancelledError from error  # the error itself would be printed as a traceback
                else:
                    submissions.has_taken, submissions.refusal = True, ""
                    return said

    return Job


async def _pause(submissions: Submissions) -> None:
    """Wait until a job may be submitted again, or none is to be: Dask closes nothing before."""
    clock = asyncio.get_running_loop().time
    until = clock() + _AGAIN_S
    while clock() < until and not submissions.is_over:
        await asyncio.sleep(0.1)


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
