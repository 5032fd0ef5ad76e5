"""Which worker gets which task, and what becomes of those that are lost."""

import asyncio
from collections.abc import Callable
from concurrent.futures import CancelledError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline import remote_workers
from pipeline.config import UserError
from pipeline.dask_executor import DaskExecutor
from pipeline.remote_workers import RemoteWorkers
from pipeline.tasks import Result, Shard, Task
from pipeline.workers import Place


class _Client:
    """A client of workers whose tasks end when a test says so."""

    def __init__(self, *workers: str, gpus: tuple[str, ...] = ()) -> None:
        self.status, self.address, self.log = "running", "tcp://head:1", list[str]()
        self.workers: dict[str, Any] = {name: {"resources": {"GPU": 1.0} if name in gpus else {}} for name in workers}
        self.outcome: Callable[[Task], Any] = lambda task: Result(task.node.name, task.shard, "done")
        self.scheduler, self.is_frozen = SimpleNamespace(identity=self._identity), False

    async def _identity(self, n_workers: int) -> dict[str, Any]:
        assert n_workers == -1, "Dask would tell of five"
        if self.is_frozen:
            await asyncio.Event().wait()
        return {"workers": self.workers}

    def sync(self, function: Any, *arguments: Any, callback_timeout: float) -> Any:
        return asyncio.run(asyncio.wait_for(function(*arguments), callback_timeout))

    def submit(self, function: Any, task: Task, inputs: Any, key: str, pure: bool, **where: Any) -> Any:
        self.log.append(f"{task.node.name} {task.shard.chunk} at {','.join(where.get('workers', ('any',)))}")
        assert where.get("allow_other_workers", "workers" not in where), (
            "it would wait for ever for those that are lost"
        )
        outcome = self.outcome(task)
        status = "finished" if isinstance(outcome, Result) else "error" if isinstance(outcome, Exception) else "lost"

        def result(timeout: float) -> Any:
            return outcome

        future = SimpleNamespace(key=key, status=status, result=result, exception=lambda: outcome)
        future.add_done_callback = lambda call: call(future)
        return future


def _executor(client: _Client, max_workers: int = 0, wait_s: float = 60.0) -> DaskExecutor:
    workers = RemoteWorkers(client, client.address, max_workers, wait_s)
    workers.wait()
    return DaskExecutor(workers, "token")


def _task(node: str, chunk: int, *, uses_gpu: bool = False) -> Task:
    stub: Any = SimpleNamespace(name=node, stage=SimpleNamespace(uses_gpu=uses_gpu))
    return Task(stub, Shard("one", chunk), None, {}, "", (), Path(), Path())  # type: ignore[arg-type]


def _submit(executor: DaskExecutor) -> None:
    for chunk in range(2):
        executor.submit(_task("crop", chunk), {})
        executor.submit(_task("round", chunk, uses_gpu=True), {})


def test_gpus_and_others_work_side_by_side() -> None:
    client = _Client("a", "b", "c", gpus=("b",))
    executor = _executor(client)
    _submit(executor)
    found = list(executor.completed())
    assert client.log[:3] == ["round 0 at b", "crop 0 at a,c", "crop 1 at a,c"] and client.log[3:] == ["round 1 at b"]
    assert len(found) == 4


@pytest.mark.parametrize("gpus", [(), ("a", "b")])
def test_workers_that_are_alike_take_everything(gpus: tuple[str, ...]) -> None:
    client = _Client("a", "b", gpus=gpus)
    executor = _executor(client)
    _submit(executor)
    assert len(list(executor.completed())) == 4
    assert client.log == ["crop 0 at any", "round 0 at any", "crop 1 at any", "round 1 at any"]


def test_a_worker_that_cannot_work_for_this_run_ends_it() -> None:
    client = _Client("a")
    client.outcome = lambda task: UserError("numpy is 2 here and 1 on worker a")
    executor = _executor(client)
    _submit(executor)
    with pytest.raises(UserError, match="numpy is 2 here"):
        list(executor.completed())


def test_no_more_tasks_than_workers_that_may_be_used() -> None:
    client = _Client("a", "b", "c")
    executor = _executor(client, max_workers=2)
    _submit(executor)
    next(executor.completed())
    assert len(client.log) == 2


def test_no_more_tasks_than_workers_when_gpus_come_and_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_workers, "_LOOK_S", 0.0)
    client, ended = _Client("a", "b"), list[Any]()
    submit = client.submit

    def endless(*arguments: Any, **named: Any) -> Any:
        future = submit(*arguments, **named)
        future.add_done_callback = lambda call: ended.append(lambda: call(future))
        return future

    client.submit = endless  # type: ignore[method-assign]
    executor = _executor(client)
    for chunk in range(4):
        executor.submit(_task("crop", chunk), {})
        executor.submit(_task("round", chunk, uses_gpu=True), {})
    assert executor._fill() and len(client.log) == 2
    client.workers["g"] = {"resources": {"GPU": 1.0}}
    assert executor._fill() and client.log[2:] == ["round 1 at g"], "the others are busy"
    del client.workers["g"]
    assert executor._fill() and len(client.log) == 3, "two workers, three tasks that were given out"
    for end in ended[:2]:
        end()
    results = executor.completed()
    assert [next(results).status for _ in range(2)] == ["done", "done"]
    assert executor._fill() and len(client.log) == 4


def test_a_suspect_waits_for_a_place_that_takes_it() -> None:
    client = _Client("a")
    executor = _executor(client)
    executor._suspects.append(executor._queue.submit(_task("round", 0, uses_gpu=True), {}))
    executor._queue.next_ready()
    others = [Place("cpu", 1, (False,), ("a",))]
    executor._workers = SimpleNamespace(client=client, check_alive=lambda: None, places=lambda: others)  # type: ignore[assignment]
    assert executor._fill() and not client.log
    others.append(Place("gpu", 1, (True,), ("g",)))
    assert executor._fill() and client.log == ["round 0 at g"]


@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("No module named 'pipeline'"),
        AttributeError("module 'pipeline.cluster_preflight' has no attribute 'run_alike'"),
        RuntimeError("Error during deserialization of the task graph. This frequently"),  # in a scheduler
    ],
)
def test_a_worker_that_cannot_load_the_code_ends_the_run(error: Exception) -> None:
    client = _Client("a")
    client.outcome = lambda task: error
    executor = _executor(client)
    _submit(executor)
    with pytest.raises(UserError, match=rf"cannot load this code \({type(error).__name__}: .*install the same"):
        list(executor.completed())


def test_another_error_of_the_engine_fails_its_shard_alone() -> None:
    client = _Client("a")
    client.outcome = lambda task: RuntimeError("too large") if task.shard.chunk else Result("crop", task.shard, "done")
    executor = _executor(client)
    for chunk in range(2):
        executor.submit(_task("crop", chunk), {})
    assert [(result.status, result.error) for result in executor.completed()] == [
        ("done", ""),
        ("failed", "RuntimeError: too large"),
    ]


def test_a_lost_result_is_asked_for_again() -> None:
    client = _Client("a")
    outcomes = iter(["its worker is gone", "again", None])

    def outcome(task: Task) -> Any:
        return next(outcomes) or Result(task.node.name, task.shard, "done")

    client.outcome = outcome
    executor = _executor(client)
    executor.submit(_task("crop", 0), {})
    assert [result.status for result in executor.completed()] == ["done"] and len(client.log) == 3


def test_a_result_that_cannot_be_fetched_is_asked_for_again() -> None:
    client, is_lost = _Client("a"), iter([True, False])
    submit = client.submit

    def losing(*arguments: Any, **named: Any) -> Any:
        future = submit(*arguments, **named)
        fetch = future.result
        future.result = lambda timeout: _raise(CancelledError()) if next(is_lost) else fetch(timeout)
        return future

    client.submit = losing  # type: ignore[method-assign]
    executor = _executor(client)
    executor.submit(_task("crop", 0), {})
    assert [result.status for result in executor.completed()] == ["done"] and len(client.log) == 2


def _raise(error: Exception) -> None:
    raise error


def test_a_scheduler_that_is_gone_is_a_sentence() -> None:
    client = _Client("a")
    executor = _executor(client)
    executor.submit(_task("crop", 0), {})
    client.status = "closed"
    with pytest.raises(UserError, match="the scheduler at tcp://head:1 is gone; what was finished is kept"):
        list(executor.completed())


def test_no_worker_for_too_long_is_a_sentence() -> None:
    with pytest.raises(UserError, match="the scheduler at tcp://head:1 has had no worker for 0 s"):
        _executor(_Client(), wait_s=0.05)


def test_a_frozen_scheduler_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_workers, "_LOOK_S", 0.0)
    monkeypatch.setattr(remote_workers, "_ANSWER_S", 0.05)
    client = _Client("a")
    executor = _executor(client, wait_s=0.2)
    executor.submit(_task("crop", 0), {})
    client.is_frozen = True
    with pytest.raises(UserError, match="the scheduler at tcp://head:1 has not answered for 0 s; what was finished is"):
        list(executor.completed())


def test_a_scheduler_that_is_slow_for_a_moment_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_workers, "_LOOK_S", 0.0)
    monkeypatch.setattr(remote_workers, "_ANSWER_S", 0.05)
    client = _Client("a")
    executor = _executor(client)
    executor.submit(_task("crop", 0), {})
    client.is_frozen = True
    assert executor._fill() and not client.log
    client.is_frozen = False
    assert [result.status for result in executor.completed()] == ["done"]
