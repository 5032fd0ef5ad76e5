"""Trainings of the same thing keep apart, and go on from what others left."""

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from assemblyhands_core.training.scratch import CHECKPOINT, own_folder, remove_idle


def _left(computation: Path, text: str, saved_s: int) -> Path:
    """Leave what a training had saved at a time; return its folder."""
    folder = computation / f"of-{text}"
    folder.mkdir(parents=True)
    (folder / CHECKPOINT).write_text(text)
    os.utime(folder / CHECKPOINT, (saved_s, saved_s))
    return folder


def _found(folder: Path) -> str:
    return (folder / CHECKPOINT).read_text()


def test_the_newest_that_has_ended_is_gone_on_from_in_a_new_folder(tmp_path: Path) -> None:
    old, new = _left(tmp_path, "old", 1), _left(tmp_path, "new", 2)
    (new / "tensorboard").mkdir()
    (new / "tensorboard/events").write_text("curve")
    inode = new.stat().st_ino
    with own_folder(tmp_path) as own:
        assert _found(own) == "new" and not new.exists() and old.is_dir()
        assert own.stat().st_ino != inode, "who was thought dead could write to it"
        assert (own / "tensorboard/events").read_text() == "curve"
    with own_folder(tmp_path) as again:
        assert _found(again) == "new" and again != own and not own.exists()


def test_of_one_at_work_a_copy_is_made_and_it_goes_on(tmp_path: Path) -> None:
    _left(tmp_path, "old", 1)
    with own_folder(tmp_path) as first:
        (first / CHECKPOINT).write_text("epoch 1")
        with own_folder(tmp_path) as second:
            assert second != first and _found(second) == "epoch 1"
            assert (second / CHECKPOINT).stat().st_mtime_ns == (first / CHECKPOINT).stat().st_mtime_ns
            (second / CHECKPOINT).write_text("epoch 2")
            remove_idle(tmp_path)
            assert _found(first) == "epoch 1" and _found(second) == "epoch 2"
        remove_idle(tmp_path)
        assert _found(first) == "epoch 1" and not second.exists()
    remove_idle(tmp_path)
    assert not tmp_path.exists()


def test_one_that_has_saved_nothing_is_not_gone_on_from(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with own_folder(tmp_path / "new") as own:
        assert list(own.iterdir()) == []
    with own_folder(tmp_path) as own:
        assert list(own.iterdir()) == []


def test_what_vanishes_while_it_is_copied_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _left(tmp_path, "old", 1)
    new, real = _left(tmp_path, "new", 2), shutil.copy2

    def vanishing(source: Path, target: Path) -> Any:
        shutil.rmtree(new, ignore_errors=True)
        return real(source, target)

    monkeypatch.setattr(shutil, "copy2", vanishing)
    with own_folder(tmp_path) as own:
        assert _found(own) == "old"


def test_what_cannot_be_copied_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = _left(tmp_path, "old", 1)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "copy2", full)
        with own_folder(tmp_path) as own:
            assert list(own.iterdir()) == [] and _found(left) == "old"
    with own_folder(tmp_path) as own:
        assert _found(own) == "old" and not left.exists()


def test_nothing_is_removed_where_nothing_is(tmp_path: Path) -> None:
    remove_idle(tmp_path / "never")
    assert not (tmp_path / "never").exists()
