"""A disk that is full or cannot be written: a sentence, a non-zero exit code, and nothing lost once there is room."""

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import Outcome, entries, pipeline

Mount = Callable[[str], Path]


def _mount(*arguments: str) -> None:
    done = subprocess.run(["mount", *arguments], capture_output=True, text=True, timeout=30)
    if done.returncode:
        pytest.skip(f"mount {' '.join(arguments)}: {done.stderr.strip()}; a small disk needs the right to mount one")


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Mount]:
    """Give a disk of its own with some bytes of room; called again, it gets other options."""
    folder = tmp_path / "disk"
    mounted: list[Path] = []

    def mount(options: str) -> Path:
        folder.mkdir(exist_ok=True)
        _mount("-t", "tmpfs", "-o", f"remount,{options}" if mounted else options, "tmpfs", str(folder))
        mounted.append(folder)
        return folder / "work"

    if os.geteuid() != 0:
        pytest.skip("only root may mount a small disk")
    yield mount
    if mounted:
        subprocess.run(["umount", "--lazy", str(folder)], check=True, timeout=30)


def _assert_sentence(outcome: Outcome, *parts: str) -> None:
    assert outcome.code in (1, 2)
    outcome.assert_refused(outcome.code, *parts)
    assert len(outcome.err.splitlines()) <= 1, outcome.err


def _fill_then_make_room(size: str, executor: str, undisturbed: Any, mount: Mount) -> None:
    workspace = mount(f"size={size}")
    _assert_sentence(pipeline(*undisturbed.command, executor, workspace=workspace), "No space left on device")
    before = entries(workspace)
    mount("size=64m")
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, executor, workspace=workspace))
    assert before.items() <= entries(workspace).items(), "something that was finished was made again"


def test_a_full_disk_is_named_and_nothing_is_lost(undisturbed: Any, small_disk: Mount) -> None:
    _fill_then_make_room("300k", "executor=serial", undisturbed, small_disk)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["16k", "60k", "150k", "300k", "400k", "700k", "1000k"])
@pytest.mark.parametrize("executor", ["executor=serial", "executor.num_workers=2"])
def test_a_disk_may_be_full_at_any_point(size: str, executor: str, undisturbed: Any, small_disk: Mount) -> None:
    _fill_then_make_room(size, executor, undisturbed, small_disk)


@pytest.mark.slow
def test_a_new_workspace_that_cannot_be_written_is_named(undisturbed: Any, small_disk: Mount) -> None:
    workspace = small_disk("size=64m,ro")
    outcome = pipeline(*undisturbed.command, workspace=workspace)
    _assert_sentence(outcome, "Read-only file system", str(workspace))
    small_disk("size=64m,rw")
    undisturbed.assert_same(workspace, pipeline(*undisturbed.command, "executor=serial", workspace=workspace))


def test_a_finished_workspace_can_be_planned_though_not_written(undisturbed: Any, small_disk: Mount) -> None:
    workspace = small_disk("size=64m")
    shutil.copytree(undisturbed.workspace, workspace, symlinks=True)
    small_disk("size=64m,ro")
    planned = pipeline("plan", *undisturbed.command[1:], workspace=workspace).assert_done()
    assert "nothing to do" in planned.said
    for command in (undisturbed.command, ["gc"]):
        _assert_sentence(pipeline(*command, workspace=workspace), "Read-only file system", str(workspace))
