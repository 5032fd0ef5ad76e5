"""Where tasks run: in this process, or on Dask workers. Both take the same tasks and give the same results."""

import os
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from pipeline.config import ExecutorConfig
from pipeline.local_cluster import LocalWorkers, local_workers
from pipeline.tasks import Result, Task, run_task
from pipeline.work import Handle

_POLL_S = 0.02


class Executor(Protocol):
    """Takes tasks with the handles of what they read, and gives back results as they come."""

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Start a task once everything that it reads is there; return its result or the promise of it."""

    def completed(self) -> Iterator[Result]:
        """Yield results as they come, until no task is under way; tasks may be submitted meanwhile."""


class SerialExecutor:
    """Runs each task when it is submitted."""

    def __init__(self) -> None:
        self._results: deque[Result] = deque()

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Run a task and return its result."""
        result = run_task(task, upstream)
        self._results.append(result)
        return result

    def completed(self) -> Iterator[Result]:
        """Yield the results so far."""
        while self._results:
            yield self._results.popleft()


class DaskExecutor:
    """Runs tasks on Dask's workers; a task starts as soon as its own inputs are there."""

    def __init__(self, workers: LocalWorkers, token: str) -> None:
        from distributed import as_completed

        self._workers, self._token = workers, token
        self._futures: Any = as_completed(raise_errors=False)
        self._tasks: dict[str, tuple[Task, list[Any]]] = {}

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Submit a task and return its future."""
        # The token keeps a long-lived scheduler from answering with an earlier run's outcome.
        key = f"{task.node.name}-{task.shard}-{self._token}"
        future = self._workers.client.submit(run_task, task, dict(upstream), key=key, pure=False)
        self._tasks[future.key] = (task, [handle for handles in upstream.values() for handle in handles])
        self._futures.add(future)
        return future

    def completed(self) -> Iterator[Result]:
        """Yield results as they come; a lost worker becomes a failed result.

        Raises:
            UserError: if workers die faster than they work.
        """
        while not self._futures.is_empty():
            if not self._futures.has_ready():
                self._workers.check_alive()
                time.sleep(_POLL_S)
                continue
            future = next(self._futures)
            self._workers.note_progress()
            yield future.result() if future.status == "finished" else self._failure(future)

    def _failure(self, future: Any) -> Result:
        task, upstream = self._tasks[future.key]
        if any(getattr(handle, "status", "") in ("error", "cancelled", "lost") for handle in upstream):
            return Result(task.node.name, task.shard, "blocked", error="needs a shard whose worker was lost")
        reason = (
            f"its worker was lost ({type(future.exception()).__name__})" if future.status == "error" else "cancelled"
        )
        return Result(task.node.name, task.shard, "failed", error=f"{reason}; out of memory is the usual cause")


def resolve_workers(config: ExecutorConfig) -> tuple[int, int]:
    """Return how many workers run and how many threads each may use, so that together they fill the cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = 1 if config.name == "serial" else config.num_workers or cores
    return workers, max(1, cores // workers)


@contextmanager
def open_executor(config: ExecutorConfig, token: str) -> Iterator[Executor]:
    """Give the executor that the configuration names, and close it."""
    if config.name == "serial":
        yield SerialExecutor()
        return
    with local_workers(*resolve_workers(config), config.memory_limit) as workers:
        yield DaskExecutor(workers, token)
