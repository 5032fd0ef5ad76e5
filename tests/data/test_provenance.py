import subprocess
from pathlib import Path

import pytest

from assemblyhands_core.data import provenance


def _repository(folder: Path) -> Path:
    for command in (
        ["init", "-q"],
        ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-q", "--allow-empty", "-m", "a"],
    ):
        subprocess.run(["git", "-C", str(folder), *command], check=True)
    return folder


def test_the_commit_is_named_and_changes_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_REPOSITORY", _repository(tmp_path))
    head = subprocess.run(["git", "-C", str(tmp_path), "rev-parse", "HEAD"], capture_output=True, text=True).stdout
    assert provenance.code_commit() == head[:12]
    (tmp_path / "file").write_text("new")
    subprocess.run(["git", "-C", str(tmp_path), "add", "file"], check=True)
    assert provenance.code_commit() == f"{head[:12]}-dirty"


def test_without_a_repository_it_is_unknown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_REPOSITORY", tmp_path / "nowhere")
    assert provenance.code_commit() == "unknown"
