"""What is looked at before workers on other machines get their first task."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.cluster_preflight import check_cluster, run_alike, versions
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

    @property
    def client(self) -> Any:
        return SimpleNamespace(scheduler_info=lambda: {"workers": self.infos}, run=self._run)

    def _run(self, function: Any, probe: Path, on_error: str = "raise") -> dict[str, Any]:
        return {address: self._answer(address, function, probe) for address in self.infos}

    def _answer(self, address: str, function: Any, probe: Path) -> Any:
        probe = self.folder_of.get(address, probe.parent) / probe.name
        if function.__name__ != "_facts":
            return function(probe)
        worker = SimpleNamespace(state=SimpleNamespace(total_resources=self.infos[address]["resources"]))
        return self.answers.get(address) or function(probe, dask_worker=worker)

    def check(self, workspace: Path, needs_gpu: bool = False) -> None:
        check_cluster(self, workspace, needs_gpu)  # type: ignore[arg-type]
        assert not list(workspace.iterdir()), "the probe is still there"


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
    cluster.answers[_ALPHA] = SimpleNamespace(versions={**here, package: there}, problem="", sees_gpu=False)
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
    run = cluster._run

    def run_there(function: Any, probe: Path, on_error: str = "raise") -> dict[str, Any]:
        (other / probe.name).mkdir(exist_ok=True)
        return run(function, probe, on_error)

    cluster._run = run_there  # type: ignore[method-assign]
    with pytest.raises(UserError, match="this machine sees 1 of the 2 files that workers have just written"):
        cluster.check(tmp_path)


def test_gpus_have_to_be_what_was_promised(tmp_path: Path) -> None:
    cluster = _Cluster()
    with pytest.raises(UserError, match="no worker offers a GPU; start one with --resources GPU=1"):
        cluster.check(tmp_path, needs_gpu=True)
    cluster.infos[_BETA]["resources"] = {"GPU": 1}
    seeing = SimpleNamespace(versions=versions(), problem="", sees_gpu=True)
    cluster.answers[_ALPHA] = cluster.answers[_BETA] = seeing
    with pytest.raises(UserError, match="sees 0 of the 2"):  # these answers left no files
        cluster.check(tmp_path, needs_gpu=True)
    cluster.answers = {}
    with pytest.raises(UserError, match=r"worker 10\.0\.0\.3 .* offers a GPU and sees none"):
        cluster.check(tmp_path)


def test_a_worker_that_came_later_runs_nothing_with_another_version(tmp_path: Path) -> None:
    stub: Any = SimpleNamespace(name="crop")
    task: Any = Task(stub, Shard("one"), None, {}, "is missing", {}, tmp_path, tmp_path / "log")  # type: ignore[arg-type]
    here = versions()
    assert run_alike(here, task, {}).error == "is missing", "run_task has answered"
    with pytest.raises(
        UserError, match=r"numpy is 1\.0 here and .* on worker .*: install the same versions everywhere"
    ):
        run_alike({**here, "numpy": "1.0"}, task, {})
