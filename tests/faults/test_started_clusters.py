"""``executor=ssh`` and ``executor=slurm``: workers that a run starts itself on other machines."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command_line import pipeline

_SBATCH = """#!/bin/sh
# What Slurm's own does, as far as it matters: takes a script, says the job's number, runs it later, apart.
cat "$1" > {folder}/job-$$.sh
nohup setsid sh {folder}/job-$$.sh > {folder}/job-$$.log 2>&1 &
echo "$!" > {folder}/pid-$$
echo "Submitted batch job $$"
"""
_SCANCEL = """#!/bin/sh
for job in "$@"; do kill -- "-$(cat {folder}/pid-$job)" 2>/dev/null; rm -f {folder}/pid-$job; done
exit 0
"""


@dataclass(frozen=True)
class _Sshd:
    port: int
    home: Path


@pytest.fixture
def sshd(tmp_path: Path) -> Iterator[_Sshd]:
    program = shutil.which("sshd", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None or os.geteuid() != 0:
        pytest.skip("an ssh server of one's own needs root and Debian's openssh-server")
    home = tmp_path / "home"
    (home / ".ssh").mkdir(parents=True, mode=0o700)
    for key in (tmp_path / "host_key", home / ".ssh" / "id_ed25519"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True, timeout=30)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    host_key = (tmp_path / "host_key.pub").read_text()
    (home / ".ssh" / "known_hosts").write_text(f"[127.0.0.1]:{port} {host_key}")
    Path("/run/sshd").mkdir(exist_ok=True)
    options = {
        "HostKey": tmp_path / "host_key",
        "AuthorizedKeysFile": home / ".ssh" / "id_ed25519.pub",
        "PidFile": tmp_path / "pid",
        "ListenAddress": "127.0.0.1",
        "StrictModes": "no",
        "UsePAM": "no",
        "PermitRootLogin": "yes",
    }
    flags = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    process = subprocess.Popen(
        [program, "-D", "-e", "-f", "/dev/null", "-p", str(port), *flags], stderr=subprocess.DEVNULL
    )
    try:
        yield _Sshd(port, home)
    finally:
        process.terminate()
        process.wait(30)


@pytest.mark.slow
def test_workers_come_by_ssh(undisturbed: Any, sshd: _Sshd, tmp_path: Path) -> None:
    workspace, home = tmp_path / "work", {"HOME": str(sshd.home)}
    ssh = ["executor=ssh", "executor.hosts=[127.0.0.1]", "executor.num_workers=2"]
    refused = pipeline(*undisturbed.command, *ssh, "executor.port=1", workspace=workspace, environment=home)
    refused.assert_refused(2, "error: the workers on 127.0.0.1 do not start")
    outcome = pipeline(*undisturbed.command, *ssh, f"executor.port={sshd.port}", workspace=workspace, environment=home)
    undisturbed.assert_same(workspace, outcome)
    assert not list((workspace / "tls").iterdir()), "the key of the run is still there"


@pytest.mark.slow
def test_workers_come_as_jobs_of_slurm(undisturbed: Any, tmp_path: Path) -> None:
    slurm, workspace = tmp_path / "slurm", tmp_path / "work"
    slurm.mkdir()
    for name, text in (("sbatch", _SBATCH), ("scancel", _SCANCEL)):
        (slurm / name).write_text(text.format(folder=slurm))
        (slurm / name).chmod(0o755)
    path = {"PATH": f"{slurm}:{os.environ['PATH']}"}
    command = [
        *undisturbed.command,
        "executor=slurm",
        "executor.num_workers=2",
        "executor.interface=lo",
        "executor.queue=short",
    ]
    undisturbed.assert_same(workspace, pipeline(*command, workspace=workspace, environment=path))
    script = next(slurm.glob("job-*.sh")).read_text()
    assert (
        "#SBATCH -p short" in script
        and "#SBATCH -t 01:00:00" in script
        and f"{sys.executable} -m distributed.cli" in script
    )
    assert (
        "127.0.0.1:0 --lifetime 50m --lifetime-stagger 5m" in script.partition("--nthreads 4")[2]
        and "tls://127.0.0.1:" in script
    )
    deadline = time.monotonic() + 30
    while list(slurm.glob("pid-*")):
        assert time.monotonic() < deadline, "jobs of a run that has ended are still there"
        time.sleep(0.05)
    assert not list((workspace / "tls").iterdir()), "the key of the run is still there"


def test_without_slurm_there_is_a_sentence(undisturbed: Any, tmp_path: Path) -> None:
    empty = {"PATH": str(tmp_path)}
    refused = pipeline(*undisturbed.command, "executor=slurm", workspace=tmp_path / "work", environment=empty)
    refused.assert_refused(2, "error: executor=slurm needs Slurm's `sbatch` on this machine")
