"""Tasks that wait for one another: which may run next, and what they read."""

import heapq
import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from pipeline.tasks import Result, Task
from pipeline.work import Handle

ANY_TASK: Final = (False, True)
"""Of stages that use a GPU where there is one, and of the others."""


@dataclass(eq=False)
class Promise:
    """A task on its way, and its result once that is there.

    Attributes:
        depth: how many tasks in a row come before it.
        order: place in the order of submission.
        num_missing: tasks whose results it waits for; ``dependents`` wait for its own.
    """

    task: Task
    upstream: Mapping[str, Sequence[Handle]]
    depth: int
    order: int
    num_missing: int
    dependents: list["Promise"] = field(default_factory=list)
    result: Result | None = None

    def __lt__(self, other: "Promise") -> bool:
        """Deep ones go first, so that what was begun is finished."""
        return (-self.depth, self.order) < (-other.depth, other.order)

    def inputs(self) -> dict[str, list[Result]]:
        """Return the results that a ready task reads from, by node."""
        return {name: [_result(handle) for handle in handles] for name, handles in self.upstream.items()}


class TaskQueue:
    """Hands out tasks whose inputs are there, those for GPUs apart from the others where that is wanted."""

    def __init__(self) -> None:
        self._ready: dict[bool, list[Promise]] = {uses_gpu: [] for uses_gpu in ANY_TASK}
        self._numbers = itertools.count()

    def __bool__(self) -> bool:
        """Whether a task is ready."""
        return any(self._ready.values())

    def submit(self, task: Task, upstream: Mapping[str, Sequence[Handle]]) -> Promise:
        """Take a task; return the promise of its result."""
        promises = [handle for handles in upstream.values() for handle in handles if isinstance(handle, Promise)]
        missing = [promise for promise in promises if promise.result is None]
        depth = 1 + max((promise.depth for promise in promises), default=0)
        promise = Promise(task, upstream, depth, next(self._numbers), len(missing))
        for other in missing:
            other.dependents.append(promise)
        if not missing:
            self.put_back(promise)
        return promise

    def next_ready(self, uses_gpu: Collection[bool] = ANY_TASK) -> Promise | None:
        """Take out the task that is to run next, if any can, of those whose stages use a GPU or do not."""
        heaps = [self._ready[kind] for kind in uses_gpu if self._ready[kind]]
        return heapq.heappop(min(heaps, key=lambda heap: heap[0])) if heaps else None

    def put_back(self, promise: Promise) -> None:
        """Note that a task can run."""
        heapq.heappush(self._ready[promise.task.node.stage.uses_gpu], promise)

    def settle(self, promise: Promise, result: Result) -> None:
        """Note a result; what waited for it alone is ready now."""
        promise.result = result
        for dependent in promise.dependents:
            dependent.num_missing -= 1
            if not dependent.num_missing:
                self.put_back(dependent)


def _result(handle: Handle) -> Result:
    result = handle.result if isinstance(handle, Promise) else handle
    assert isinstance(result, Result), "a task is ready when all that it reads is there"
    return result
