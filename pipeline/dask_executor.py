"""Runs tasks on Dask's workers, no more at a time than there are workers.

Dask itself would take all tasks at once; but it blames every task that a lost worker had been given, so that one shard
that kills its worker again and again would take shards down that never ran. Here a lost worker was at one task, and a
task that lost two workers is run once more with nothing beside it before it counts as failed.
"""

import itertools
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from pipeline.config import UserError
from pipeline.interrupts import check_interrupted
from pipeline.task_queue import Promise, TaskQueue
from pipeline.tasks import Result, Task, run_task
from pipeline.work import Handle
from pipeline.workers import Place, Workers

_FETCH_S = 60.0  # for a result, which is small
_POLL_S = 0.1  # how often one looks whether the user wants to stop, or everybody is dead


class DaskExecutor:
    """Gives each worker one task at a time; a task becomes ready as soon as its own inputs are there.

    Args:
        workers: Who works.
        token: No other run has it.
        run: What a worker calls for a task; a `UserError` of it ends the run.
    """

    def __init__(self, workers: Workers, token: str, run: Callable[..., Result] = run_task) -> None:
        self._workers, self._token, self._run = workers, token, run
        self._ended: SimpleQueue[Any] = SimpleQueue()  # futures, in the order in which they end
        self._numbers = itertools.count()
        self._queue = TaskQueue()
        self._running: dict[str, tuple[Promise, str]] = {}  # by Dask's key, with the name of the place
        self._suspects: deque[Promise] = deque()  # they lost their workers
        self._on_trial: set[Promise] = set()

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Handle:
        """Take a task; return the promise of its result."""
        return self._queue.submit(task, upstream)

    def completed(self) -> Iterator[Result]:
        """Yield results as they come.

        Raises:
            UserError: if workers die faster than they work, or one of them cannot work for this run.
            KeyboardInterrupt: if the user wants to stop.
        """
        while self._fill():
            try:
                future = self._ended.get(timeout=_POLL_S)
            except Empty:
                continue
            promise, _ = self._running.pop(future.key)
            if (result := self._outcome(promise, future)) is not None:
                self._workers.note_progress()
                self._queue.settle(promise, result)
                yield result

    def _fill(self) -> bool:
        """Give work to all workers, a suspect only to one while the others rest; return whether any is to be done."""
        check_interrupted()
        self._workers.check_alive()
        places = [place for place in self._workers.places() if place.num_workers]
        busy = Counter(place for _, place in self._running.values())
        # Places come and go with the kinds of workers; a task that began at one that is gone still has its worker.
        num_workers = sum(place.num_workers for place in places)
        for place in places:
            for _ in range(min(place.num_workers - busy[place.name], num_workers - len(self._running))):
                if promise := self._queue.next_ready(place.uses_gpu):
                    self._start(promise, place)
        if self._suspects and not self._running:
            self._try_suspect(places)
        return bool(self._running or self._queue or self._suspects)

    def _try_suspect(self, places: Sequence[Place]) -> None:
        """Run the first suspect that one of these places takes."""
        for suspect in self._suspects:
            if place := next((place for place in places if _uses_gpu(suspect) in place.uses_gpu), None):
                self._suspects.remove(suspect)
                self._on_trial.add(suspect)
                self._start(suspect, place)
                return

    def _start(self, promise: Promise, place: Place) -> None:
        # A key of its own keeps a long-lived scheduler from answering with an earlier outcome.
        key = f"{promise.task.node.name}-{promise.task.shard}-{self._token}-{next(self._numbers)}"
        # Others than those at the place take it only when all of these are lost.
        there = {} if place.addresses is None else {"workers": place.addresses, "allow_other_workers": True}
        future = self._workers.client.submit(self._run, promise.task, promise.inputs(), key=key, pure=False, **there)
        self._running[key] = promise, place.name
        future.add_done_callback(self._ended.put)

    def _outcome(self, promise: Promise, future: Any) -> Result | None:
        """Return a task's result, or None if it has to run again."""
        from distributed import KilledWorker

        with suppress(CancelledError, OSError):  # the result may be lost together with the worker that has it
            if future.status == "finished":
                result: Result = future.result(timeout=_FETCH_S)
                return result
        if future.status != "error":
            self._queue.put_back(promise)
            return None
        error = future.exception()
        if isinstance(error, UserError):
            raise error
        if _is_of_loading(error):
            raise UserError(
                f"a worker or the scheduler cannot load this code ({type(error).__name__}: {error}); what was finished "
                "is kept: install the same version of assemblyhands there, start it in that environment, and repeat "
                "the command"
            ) from error
        if isinstance(error, KilledWorker) and promise not in self._on_trial:
            self._suspects.append(promise)
            return None
        reason = (
            "its worker was lost every time; out of memory is the usual cause"
            if isinstance(error, KilledWorker)
            else f"{type(error).__name__}: {error}"
        )
        return Result(promise.task.node.name, promise.task.shard, "failed", error=reason)


def _uses_gpu(promise: Promise) -> bool:
    return promise.task.node.stage.uses_gpu


def _is_of_loading(error: Exception) -> bool:
    """Whether a task could not be unpickled; errors of stages never come here, as `run_task` makes results of them."""
    is_of_scheduler = isinstance(error, RuntimeError) and str(error).startswith("Error during deserialization")
    return is_of_scheduler or isinstance(error, ImportError | AttributeError)
