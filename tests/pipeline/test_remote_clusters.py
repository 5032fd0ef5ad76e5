"""Schedulers that cannot be used are named, and not waited for."""

import asyncio
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from pipeline import remote_clusters, slurm_cluster
from pipeline.config import UserError
from pipeline.executor_config import ClusterConfig, SlurmConfig, SshConfig, TlsConfig
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


def _slurm(**changes: Any) -> SlurmConfig:
    job = {"queue": "shrt", "account": None, "cores": 1, "memory": "1GB", "gpus": 0, "walltime": "01:00:00"}
    life = {"lifetime": "50m", "lifetime_stagger": "1s", "interface": "lo"}
    lines = {"job_extra_directives": (), "job_script_prologue": ()}
    shared = {"num_workers": 2, "num_threads": 1, "wait_s": 60.0, "needs_gpu": False}
    return SlurmConfig(**{"name": "slurm", **job, **life, **lines, **shared, **changes})


def _sbatch(folder: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    (folder / "sbatch").write_text(f"#!/bin/sh\n{text}\n")
    (folder / "scancel").write_text("#!/bin/sh\n")
    for name in ("sbatch", "scancel"):
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


def test_a_job_that_slurm_refuses_is_a_sentence_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _sbatch(tmp_path, monkeypatch, "echo sbatch: error: invalid partition specified: shrt >&2; exit 1")
    sentence = (
        "^Slurm refuses the jobs of this run: sbatch: error: invalid partition specified: shrt; set executor.queue"
    )
    with pytest.raises(UserError, match=sentence), remote_workers(_slurm(), tmp_path):
        pass


def test_a_job_that_was_refused_is_submitted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = RuntimeError("Command exited with non-zero exit code.\nstdout:\n\nstderr:\nlimit of\njobs\n")
    answers, seen = iter([refusal, refusal, "Submitted batch job 7"]), list[str]()
    submissions = slurm_cluster.Submissions()

    async def submit(job: Any, script_filename: str) -> str:
        seen.append(submissions.refusal)
        if isinstance(answer := next(answers), Exception):
            raise answer
        return answer

    monkeypatch.setattr(slurm_cluster, "_AGAIN_S", 0.0)
    monkeypatch.setattr("dask_jobqueue.slurm.SLURMJob._submit_job", submit)
    job = object.__new__(slurm_cluster._job_type(submissions))
    assert asyncio.run(job._submit_job("job.sh")) == "Submitted batch job 7"
    assert seen == ["", "limit of jobs", "limit of jobs"]
    assert submissions.has_taken and not submissions.problem()
    answers, submissions.is_over = iter([refusal]), True
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(job._submit_job("job.sh"))
    assert submissions.refusal and not submissions.problem(), "others were taken, and may come"


@pytest.mark.parametrize(("parameter", "value"), [("memory", "16XB"), ("interface", "ib9")])
def test_a_job_that_cannot_be_described_is_a_sentence(
    parameter: str, value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _sbatch(tmp_path, monkeypatch, "exit 1")
    sentence = f"^no job can be made of .*executor.{parameter}={value} .*; see conf/executor/slurm.yaml"
    with pytest.raises(UserError, match=sentence), remote_workers(_slurm(**{parameter: value}), tmp_path):
        pass
