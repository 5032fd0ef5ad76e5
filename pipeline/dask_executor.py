"""Runs tasks on Dask's workers, no more at a time than there are workers.

Dask itself would take all tasks at once; but it blames every task that a lost worker had been given, so that one shard
that kills its worker again and again would take shards down that never ran. Here a lost worker was at one task, and a
task that lost two workers is run once more with nothing beside it before it counts as failed.
"""

import itertools
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pipeline.interrupts import check_interrupted
from pipeline.local_cluster import LocalWorkers
from pipeline.task_queue import Promise, TaskQueue
from pipeline.tasks import Result, Task, run_task
from pipeline.work import Handle

_POLL_S = 0.01


class DaskExecutor:
    """Gives each worker one task at a time; a task becomes ready as soon as its own inputs are there."""

    def __init__(self, workers: LocalWorkers, token: str) -> None:
        from distributed import as_completed

        self._workers, self._token = workers, token
        self._futures: Any = as_completed(raise_errors=False)
        self._numbers = itertools.count()
        self._queue = TaskQueue()
        self._running: dict[str, Promise] = {}
        self._suspects: deque[Promise] = deque()  # they lost their workers
        self._on_trial: set[Promise] = set()

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Take a task; return the promise of its result."""
        return self._queue.submit(task, upstream)

    def completed(self) -> Iterator[Result]:
        """Yield results as they come.

        Raises:
            UserError: if workers die faster than they work.
            KeyboardInterrupt: if the user wants to stop.
        """
        while self._fill():
            check_interrupted()
            if not self._futures.has_ready():
                self._workers.check_alive()
                time.sleep(_POLL_S)
                continue
            future = next(self._futures)
            promise = self._running.pop(future.key)
            if (result := self._outcome(promise, future)) is not None:
                self._workers.note_progress()
                self._queue.settle(promise, result)
                yield result

    def _fill(self) -> bool:
        """Give work to all workers, a suspect only to one while the others rest; return whether any is under way."""
        while len(self._running) < self._workers.num_workers and (promise := self._queue.next_ready()):
            self._start(promise)
        if not self._running and self._suspects:
            suspect = self._suspects.popleft()
            self._on_trial.add(suspect)
            self._start(suspect)
        return bool(self._running)

    def _start(self, promise: Promise) -> None:
        # A key of its own keeps a long-lived scheduler from answering with an earlier outcome.
        key = f"{promise.task.node.name}-{promise.task.shard}-{self._token}-{next(self._numbers)}"
        future = self._workers.client.submit(run_task, promise.task, promise.inputs(), key=key, pure=False)
        self._running[key] = promise
        self._futures.add(future)

    def _outcome(self, promise: Promise, future: Any) -> Result | None:
        """Return a task's result, or None if it has to run again."""
        from distributed import KilledWorker

        if future.status == "finished":
            result: Result = future.result()
            return result
        if future.status != "error":  # the result was lost together with the worker that had it
            self._queue.put_back(promise)
            return None
        error = future.exception()
        if isinstance(error, KilledWorker) and promise not in self._on_trial:
            self._suspects.append(promise)
            return None
        reason = (
            "its worker was lost every time; out of memory is the usual cause"
            if isinstance(error, KilledWorker)
            else f"{type(error).__name__}: {error}"
        )
        return Result(promise.task.node.name, promise.task.shard, "failed", error=reason)
