"""Where tasks run: in this process, or on Dask workers. Both take the same tasks and give the same results."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from pipeline.cluster_preflight import checked_cluster
from pipeline.dask_executor import DaskExecutor
from pipeline.executor_config import ExecutorConfig, LocalConfig, SshConfig
from pipeline.local_cluster import local_workers
from pipeline.remote_clusters import remote_workers
from pipeline.task_queue import TaskQueue
from pipeline.tasks import Result, Task, run_task
from pipeline.work import Handle


class Executor(Protocol):
    """Takes tasks with the handles of what they read, and gives back results as they come."""

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Take a task that is to run once everything that it reads is there; return the promise of its result."""

    def completed(self) -> Iterator[Result]:
        """Yield results as they come, until no task is under way; tasks may be submitted meanwhile."""


class SerialExecutor:
    """Runs one task after the other in this process."""

    def __init__(self) -> None:
        self._queue = TaskQueue()

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Take a task; return the promise of its result."""
        return self._queue.submit(task, upstream)

    def completed(self) -> Iterator[Result]:
        """Run what is ready until nothing is; yield each result."""
        while promise := self._queue.next_ready():
            result = run_task(promise.task, promise.inputs())
            self._queue.settle(promise, result)
            yield result


def resolve_workers(config: ExecutorConfig) -> tuple[int, int]:
    """Return how many workers run and how many threads each may use, here so that together they fill the cores."""
    if not isinstance(config, LocalConfig):
        num_hosts = len(config.hosts) if isinstance(config, SshConfig) else 1
        return max(config.num_workers, 1) * num_hosts, config.num_threads
    workers = 1 if config.name == "serial" else config.num_workers or num_cores()
    return workers, max(1, num_cores() // workers)


def num_cores() -> int:
    """Return how many cores of this machine this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_executor(config: ExecutorConfig, workspace: Path, token: str) -> Iterator[Executor]:
    """Give the executor that the configuration names, and close it.

    Raises:
        UserError: its workers do not start, or cannot do the work.
    """
    if config.name == "serial":
        yield SerialExecutor()
        return
    if isinstance(config, LocalConfig):
        with local_workers(*resolve_workers(config), config.memory_limit) as workers:
            yield DaskExecutor(workers, token)
        return
    with (
        remote_workers(config, workspace) as others,
        checked_cluster(others, workspace, config.needs_gpu) as run_alike,
    ):
        yield DaskExecutor(others, token, run_alike)
