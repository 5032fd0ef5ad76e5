"""What is looked at before workers on other machines get their first task."""

import asyncio
import importlib.metadata
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from pipeline import cluster_preflight
from pipeline.cluster_preflight import Facts, checked_cluster, run_alike, versions
from pipeline.config import UserError
from pipeline.tasks import Shard, Task

_ALPHA, _BETA = "tcp://10.0.0.2:1", "tcp://10.0.0.3:1"


class _Cluster:
    """Two workers in this process that can be told to be odd."""

    def __init__(self) -> None:
        self.infos: dict[str, Any] = {
            address: {"host": address[6:14], "nthreads": 1, "resources": {}} for address in (_ALPHA, _BETA)
        }
        self.answers: dict[str, Any] = {}
        self.folder_of: dict[str, Path] = {}

        self.address = "tcp://10.0.0.1:1"

    def ask(self) -> dict[str, Any]:
        return self.infos

    @property
    def client(self) -> Any:
        return SimpleNamespace(sync=self._sync, run=self._run)

    def _sync(self, function: Any, *arguments: Any, callback_timeout: float, **named: Any) -> Any:
        return asyncio.run(asyncio.wait_for(function(*arguments, **named), callback_timeout))

    async def _run(self, function: Any, probe: Path, on_error: str) -> dict[str, Any]:
        assert on_error == "return"
        return {address: self._answer(address, function, probe) for address in self.infos}

    def _answer(self, address: str, function: Any, probe: Path) -> Any:
        probe = self.folder_of.get(address, probe.parents[1]) / "scratch" / probe.name
        if function.__name__ != "_facts":
            return function(probe)
        return self.answers.get(address) or function(probe, dask_worker=_worker(**self.infos[address]))

    def check(self, workspace: Path, needs_gpu: bool = False) -> None:
        with checked_cluster(self, workspace, needs_gpu):  # type: ignore[arg-type]
            assert list(workspace.glob("scratch/probe-*")), "late workers have nothing to look at"
        assert not list(workspace.glob("scratch/*")), "the probe is still there"


def _worker(nthreads: int = 1, resources: Any = None, **others: Any) -> Any:
    return SimpleNamespace(state=SimpleNamespace(nthreads=nthreads, total_resources=resources or {}))


def _sound(**changes: Any) -> Facts:
    return replace(Facts(versions(), 1, False, False, ""), **changes)


def test_a_sound_cluster_passes(tmp_path: Path) -> None:
    _Cluster().check(tmp_path)


def test_a_worker_that_takes_two_tasks_is_refused(tmp_path: Path) -> None:
    cluster = _Cluster()
    cluster.infos[_BETA]["nthreads"] = 4
    with pytest.raises(UserError, match=rf"worker 10\.0\.0\.3 \({_BETA}\) takes 4 tasks at a time; .*--nthreads 1"):
        cluster.check(tmp_path)


@pytest.mark.parametrize(("package", "there"), [("numpy", "1.0"), ("assemblyhands' own code", "0123456789ab")])
def test_another_version_is_named(tmp_path: Path, package: str, there: str) -> None:
    cluster = _Cluster()
    here = versions()
    cluster.answers[_ALPHA] = _sound(versions={**here, package: there})
    with pytest.raises(UserError, match=rf"{package} is {here[package]} here and {there} on worker 10\.0\.0\.2"):
        cluster.check(tmp_path)


def test_code_that_does_not_load_is_named(tmp_path: Path) -> None:
    cluster = _Cluster()
    cluster.answers[_BETA] = ModuleNotFoundError("No module named 'pipeline'")
    with pytest.raises(UserError, match=r"worker 10\.0\.0\.3 .* cannot run this code \(ModuleNotFoundError: No module"):
        cluster.check(tmp_path)


def test_a_workspace_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    cluster = _Cluster()
    cluster.folder_of[_ALPHA] = tmp_path.parent / "elsewhere"
    with pytest.raises(UserError, match=r"worker 10\.0\.0\.2 .* cannot write to .* \(No such file or directory\)"):
        cluster.check(tmp_path)


def test_a_workspace_that_is_another_folder_is_named(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    cluster = _Cluster()
    other = cluster.folder_of[_BETA] = tmp_path_factory.mktemp("other")
    answer = cluster._answer

    def answer_there(address: str, function: Any, probe: Path) -> Any:
        (other / "scratch" / probe.name).mkdir(parents=True, exist_ok=True)
        return answer(address, function, probe)

    cluster._answer = answer_there  # type: ignore[method-assign]
    with pytest.raises(UserError, match="this machine sees 1 of the 2 files that workers have just written"):
        cluster.check(tmp_path)


def test_gpus_have_to_be_what_was_promised(tmp_path: Path) -> None:
    cluster = _Cluster()
    with pytest.raises(UserError, match="no worker offers a GPU; start one with --resources GPU=1"):
        cluster.check(tmp_path, needs_gpu=True)
    cluster.infos[_BETA]["resources"] = {"GPU": 1}
    seeing = _sound(offers_gpu=True, sees_gpu=True)
    cluster.answers[_ALPHA] = cluster.answers[_BETA] = seeing
    with pytest.raises(UserError, match="sees 0 of the 2"):  # these answers left no files
        cluster.check(tmp_path, needs_gpu=True)
    cluster.answers = {}
    with pytest.raises(UserError, match=r"worker 10\.0\.0\.3 .* offers a GPU and sees none"):
        cluster.check(tmp_path)


def test_workers_that_do_not_answer_are_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_preflight, "_ANSWER_S", 0.05)
    cluster = _Cluster()

    async def hang(*arguments: Any, **named: Any) -> Any:
        await asyncio.Event().wait()

    cluster._run = hang  # type: ignore[method-assign]
    with pytest.raises(UserError, match=r"the scheduler at tcp://10\.0\.0\.1:1 or one of its workers has not answered"):
        cluster.check(tmp_path)


def test_code_that_changed_after_it_was_loaded_is_old_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that lives on from an earlier run answers for what it has in memory, not for what is on the disk."""
    loaded = versions()
    monkeypatch.setattr(cluster_preflight, "_digest_of_code", lambda: "0123456789ab")
    assert cluster_preflight._facts(tmp_path, _worker()).versions == loaded
    cluster = _Cluster()
    cluster.answers[_ALPHA] = _sound(versions={**loaded, "assemblyhands' own code": "an older one"})
    with pytest.raises(UserError, match=r"own code is .* here and an older one on .*, or restart the worker if it was"):
        cluster.check(tmp_path)


def test_versions_are_of_all_that_results_depend_on() -> None:
    found = versions()
    assert {"Python", "numpy", "scipy", "timm", "torch", "torchvision", "lightning", "embreex"} <= found.keys()
    assert found["protobuf"] == importlib.metadata.version("protobuf"), "its requirement has a limit"
    assert found["mediapipe"] == importlib.metadata.version("mediapipe") and "onnxruntime" in found
    assert not found.keys() & {"pytest", "ruff"}, "nobody needs them to work"


def _task(workspace: Path, num_threads: int = 1) -> Any:
    stub: Any = SimpleNamespace(name="crop")
    return Task(stub, Shard("one"), None, {}, "is missing", {}, workspace, workspace / "log", num_threads)  # type: ignore[arg-type]


@pytest.fixture
def late(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Dask's worker that this process is, which nobody has looked at."""
    worker = _worker()
    monkeypatch.setattr("distributed.get_worker", lambda: worker)
    cluster_preflight._facts_of_process.cache_clear()
    return worker


def test_a_worker_that_came_later_runs_nothing_with_another_version(tmp_path: Path, late: Any) -> None:
    here = versions()
    assert run_alike(here, tmp_path, _task(tmp_path), {}).error == "is missing", "run_task has answered"
    with pytest.raises(
        UserError, match=r"numpy is 1\.0 here and .* on worker .*: install the same versions everywhere"
    ):
        run_alike({**here, "numpy": "1.0"}, tmp_path, _task(tmp_path), {})


def test_a_worker_that_came_later_and_has_another_folder_is_named(tmp_path: Path, late: Any) -> None:
    with pytest.raises(UserError, match=r"cannot write to .* \(No such file or directory\); it has to be shared"):
        run_alike(versions(), tmp_path / "scratch" / "probe", _task(tmp_path), {})


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        ({"nthreads": 2}, "takes 2 tasks at a time; start it with --nthreads 1"),
        ({"total_resources": {"GPU": 1.0}}, "offers a GPU and sees none"),
    ],
)
def test_a_worker_that_came_later_and_cannot_do_the_work_is_named(
    state: Any, sentence: str, tmp_path: Path, late: Any
) -> None:
    vars(late.state).update(state)
    with pytest.raises(UserError, match=sentence):
        run_alike(versions(), tmp_path, _task(tmp_path), {})


def test_a_worker_is_looked_at_once_in_each_run(tmp_path: Path, late: Any) -> None:
    probes = [tmp_path / "one", tmp_path / "two"]
    for probe in probes:
        probe.mkdir()
        for _ in range(3):
            run_alike(versions(), probe, _task(tmp_path), {})
    assert [len(list(probe.iterdir())) for probe in probes] == [1, 1]


def test_opencv_takes_the_threads_of_the_task(tmp_path: Path, late: Any) -> None:
    before = cv2.getNumThreads()
    try:
        for num_threads in (3, 2):
            run_alike(versions(), tmp_path, _task(tmp_path, num_threads), {})
            assert cv2.getNumThreads() == num_threads
    finally:
        cv2.setNumThreads(before)
