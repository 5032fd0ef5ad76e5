"""Run ``python -m pipeline`` as a user does, in processes of its own, none of which can hang or stay behind."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
TIMEOUT_S = 180.0  # of a command that takes seconds when the machine is free

# Rich cuts sentences to the terminal's width; a piped run prints lines of 140 columns.
_ENVIRONMENT = {"PYTHONPATH": str(REPOSITORY), "PYTHONUNBUFFERED": "1"}


@dataclass(frozen=True)
class Outcome:
    """How a command ended: its exit code, and what it said on standard output and standard error."""

    code: int
    out: str
    err: str

    @property
    def said(self) -> str:
        """Return all that was said, with every run of white space as one space, as tables break lines."""
        return " ".join(f"{self.out} {self.err}".replace("│", " ").split())

    def assert_done(self) -> "Outcome":
        """Return itself if all went well and standard error stayed empty."""
        assert self.code == 0 and not self.err, f"exit code {self.code}\n{self.out}\n{self.err}"
        return self

    def assert_refused(self, code: int, *parts: str) -> None:
        """Check the exit code, that a sentence holds these parts, and that no traceback is shown."""
        assert self.code == code, f"exit code {self.code} instead of {code}\n{self.out}\n{self.err}"
        assert "Traceback" not in self.out + self.err and "HYDRA_FULL_ERROR" not in self.err, self.err
        assert not (missing := [part for part in parts if part not in self.said]), f"{missing} not in: {self.said}"


def start(
    *arguments: str, workspace: Path, environment: Mapping[str, str] | None = None, on: Sequence[str] = ()
) -> "subprocess.Popen[str]":
    """Start a command in a process group of its own, in the workspace's parent folder; ``on`` is put before it."""
    return subprocess.Popen(
        [*on, sys.executable, "-m", "pipeline", *arguments],
        cwd=workspace.parent,
        env={**os.environ, **_ENVIRONMENT, "ASSEMBLYHANDS_WORK": str(workspace), **(environment or {})},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(process: "subprocess.Popen[str]", timeout_s: float = TIMEOUT_S) -> Outcome:
    """Wait for a command; one that hangs is killed with all its workers and fails the test."""
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        raise AssertionError(f"{process.args!r} hangs; so far it said\n{out}\n{err}") from None
    return Outcome(process.returncode, out, err)


def pipeline(*arguments: str, workspace: Path, environment: Mapping[str, str] | None = None) -> Outcome:
    """Run a command to its end."""
    return finish(start(*arguments, workspace=workspace, environment=environment))


def run_record(workspace: Path, run: str = "latest") -> dict[str, Any]:
    """Return a run's ``run.json``."""
    record: dict[str, Any] = json.loads((workspace / "runs" / run / "run.json").read_text())
    return record


def digests(workspace: Path, run: str = "latest") -> dict[str, str]:
    """Return a run's content digest by node."""
    found: dict[str, str] = run_record(workspace, run)["digests"]
    return found


def entries(workspace: Path) -> dict[Path, int]:
    """Return the folders of the store's entries with their inode, which tells an entry from one made anew."""
    folders = (path for path in (workspace / "store").glob("[!.]*/[!.]*") if path.is_dir())
    return {path.relative_to(workspace / "store"): path.stat().st_ino for path in sorted(folders)}


def new_stages(workspace: Path, before: Mapping[Path, int]) -> dict[str, int]:
    """Return by stage how many entries were made since ``before``."""
    made = [path.parts[0] for path, inode in entries(workspace).items() if before.get(path) != inode]
    return {stage: made.count(stage) for stage in dict.fromkeys(made)}
