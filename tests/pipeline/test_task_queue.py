from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.task_queue import Promise, TaskQueue
from pipeline.tasks import Result, Shard, Task


def _task(node: str, chunk: int | None = None, *, uses_gpu: bool = False) -> Task:
    stub: Any = SimpleNamespace(name=node, stage=SimpleNamespace(uses_gpu=uses_gpu))
    return Task(stub, Shard("one", chunk), None, {}, "", (), Path(), Path())  # type: ignore[arg-type]


def _done(promise: Promise) -> Result:
    return Result(promise.task.node.name, promise.task.shard, "done")


def test_a_task_waits_for_all_that_it_reads() -> None:
    queue = TaskQueue()
    parts = [queue.submit(_task("part", chunk), {}) for chunk in range(2)]
    whole = queue.submit(_task("whole"), {"part": parts})
    assert [queue.next_ready() for _ in range(3)] == [*parts, None]
    queue.settle(parts[1], _done(parts[1]))
    assert queue.next_ready() is None
    queue.settle(parts[0], _done(parts[0]))
    assert queue.next_ready() is whole
    assert [result.shard.chunk for result in whole.inputs()["part"]] == [0, 1]


def test_what_was_begun_is_finished_first() -> None:
    queue = TaskQueue()
    first, second = (queue.submit(_task("first", chunk), {}) for chunk in range(2))
    after = queue.submit(_task("after", 0), {"first": [first]})
    assert queue.next_ready() is first
    queue.settle(first, _done(first))
    assert [queue.next_ready(), queue.next_ready()] == [after, second]


def test_results_of_earlier_runs_need_no_waiting() -> None:
    queue = TaskQueue()
    reused = Result("part", Shard("one", 0), "reused")
    promise = queue.submit(_task("whole"), {"part": [reused]})
    assert queue.next_ready() is promise and promise.inputs() == {"part": [reused]}


def test_a_task_may_be_put_back() -> None:
    queue = TaskQueue()
    promise = queue.submit(_task("part", 0), {})
    assert queue.next_ready() is promise
    queue.put_back(promise)
    assert queue.next_ready() is promise


@pytest.mark.parametrize("status", ["failed", "blocked"])
def test_failures_are_results_too(status: Any) -> None:
    queue = TaskQueue()
    part = queue.submit(_task("part", 0), {})
    whole = queue.submit(_task("whole"), {"part": [part]})
    queue.next_ready()
    queue.settle(part, Result("part", part.task.shard, status))
    assert queue.next_ready() is whole and not whole.inputs()["part"][0].has_entry


def test_tasks_for_gpus_can_be_asked_for_alone() -> None:
    queue = TaskQueue()
    slow, quick = queue.submit(_task("crop"), {}), queue.submit(_task("round"), {})
    fast = queue.submit(_task("round", uses_gpu=True), {})
    after = queue.submit(_task("round", 1, uses_gpu=True), {"round": [quick]})
    assert queue.next_ready([True]) is fast and queue.next_ready([True]) is None
    assert queue.next_ready([False]) is slow and queue.next_ready() is quick and not queue
    queue.settle(quick, _done(quick))
    queue.put_back(slow)
    assert queue and queue.next_ready() is after, "deep ones go first, of either kind"
    assert queue.next_ready([True]) is None and queue.next_ready() is slow
