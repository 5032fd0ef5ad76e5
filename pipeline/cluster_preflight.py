"""Looked at before the first task runs on other machines: a sentence now instead of a thousand failed tasks later."""

import importlib.metadata
import platform
import uuid
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.digests import digest_file, digest_json
from pipeline.config import CONF_FOLDER, UserError
from pipeline.remote_workers import GPU, RemoteWorkers
from pipeline.tasks import Result, Task, run_task

_PACKAGES: Final = (
    "numpy",
    "pyarrow",
    "pandas",
    "torch",
    "opencv-python-headless",
    "av",
    "numba",
    "dask",
    "distributed",
)
"""Results, or what is sent from here to there, depend on them."""

_SOURCES: Final = ("assemblyhands_core", "stages", "pipeline")
_OURS: Final = "assemblyhands' own code"


@dataclass(frozen=True)
class Facts:
    """What a worker says about itself.

    Attributes:
        versions: by package, and a digest of our own code.
        problem: why it cannot write to the workspace; empty if it can.
        sees_gpu: whether torch does; only asked of workers that offer one.
    """

    versions: Mapping[str, str]
    problem: str
    sees_gpu: bool


def check_cluster(workers: RemoteWorkers, workspace: Path, needs_gpu: bool) -> None:
    """Check that all workers can do what this machine asks of them.

    Raises:
        UserError: naming the workers that cannot, and the remedy.
    """
    client, infos = workers.client, workers.client.scheduler_info()["workers"]
    names = {address: f"{info.get('host', address)} ({address})" for address, info in infos.items()}
    _check_threads(infos, names)
    probe = workspace / f".probe-{uuid.uuid4().hex}"
    probe.mkdir(parents=True)
    try:
        found = _answers(client.run(_facts, probe, on_error="return"), names)
        _check_versions(versions(), {name: facts.versions for name, facts in found.items()})
        _check_shared(client, probe, found, names)
    finally:
        for path in probe.glob("*"):
            path.unlink(missing_ok=True)
        probe.rmdir()
    offers = {names[address] for address, info in infos.items() if info["resources"].get(GPU)}
    _check_gpus(offers, found, needs_gpu)


def versions() -> dict[str, str]:
    """Return the versions of what results depend on, on this machine, and a digest of our own code."""
    found = {"Python": platform.python_version(), _OURS: _digest_of_code()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def run_alike(here: Mapping[str, str], task: Task, upstream: Mapping[str, Sequence[Result]]) -> Result:
    """Run a task on a worker, which may have come after the others were looked at.

    Args:
        here: `versions` of the machine that asks.
        task, upstream: as for `run_task`.

    Raises:
        UserError: the worker's versions are others.
    """
    _check_versions(here, {platform.node(): _versions_of_process()})
    return run_task(task, upstream)


@cache
def _versions_of_process() -> dict[str, str]:
    return versions()


def _facts(probe: Path, dask_worker: Any) -> Facts:
    """Say what this worker is, and leave a file in the probe's folder. Dask gives the worker to that name."""
    problem = ""
    try:
        (probe / uuid.uuid4().hex).write_text("x")
    except OSError as error:
        problem = f"{error.strerror or error}"
    return Facts(versions(), problem, GPU in dask_worker.state.total_resources and _sees_gpu())


def _sees_gpu() -> bool:
    import torch  # takes seconds, and blocks the worker meanwhile

    return torch.cuda.is_available()


def _count_files(probe: Path) -> int:
    """Return how many files others have left; by their names, as a network file system may remember an older list."""
    return sum(1 for _ in probe.iterdir())


def _digest_of_code() -> str:
    root = CONF_FOLDER.parent
    files = sorted(path for folder in _SOURCES for path in (root / folder).rglob("*.py"))
    return digest_json({str(path.relative_to(root)): digest_file(path) for path in files})[:12]


def _answers(answers: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Facts]:
    """Return each worker's facts.

    Raises:
        UserError: one cannot even say them.
    """
    for address, answer in answers.items():
        if isinstance(answer, BaseException):
            raise UserError(
                f"worker {names.get(address, address)} cannot run this code ({type(answer).__name__}: {answer}); "
                "install the same version of assemblyhands there, and start it in that environment"
            )
    return {names.get(address, address): answer for address, answer in answers.items()}


def _check_threads(infos: Mapping[str, Any], names: Mapping[str, str]) -> None:
    for address, info in infos.items():
        if info["nthreads"] != 1:
            raise UserError(
                f"worker {names[address]} takes {info['nthreads']} tasks at a time; start it with --nthreads 1, and "
                "more of them with --nworkers (executor.num_threads says how many threads a task may use)"
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
            + "; results would depend on who makes them: install the same versions everywhere (constraints.txt)"
        )


def _check_shared(client: Any, probe: Path, found: Mapping[str, Facts], names: Mapping[str, str]) -> None:
    workspace = probe.parent
    for name, facts in found.items():
        if facts.problem:
            raise UserError(f"worker {name} cannot write to {workspace} ({facts.problem}); it has to be shared by all")
    counts = {"this machine": _count_files(probe)}
    counts |= {names.get(address, address): count for address, count in client.run(_count_files, probe).items()}
    for name, count in counts.items():
        if count < len(found):
            raise UserError(
                f"{name} sees {count} of the {len(found)} files that workers have just written to {workspace}: it is "
                "not the same folder everywhere; give one on a shared file system, by workspace=PATH"
            )


def _check_gpus(offers: set[str], found: Mapping[str, Facts], needs_gpu: bool) -> None:
    for name in sorted(offers):
        if name in found and not found[name].sees_gpu:
            raise UserError(
                f"worker {name} offers a GPU and sees none; start it without --resources {GPU}=1, or see why"
            )
    if needs_gpu and not offers:
        raise UserError(f"no worker offers a GPU; start one with --resources {GPU}=1, or set executor.needs_gpu=false")
