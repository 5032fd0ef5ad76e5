"""Where trainings keep their state: each in a folder of its own, so that none takes another's weights for its own.

Several may be making the same entry: two runs, or a host that was cut off and the one that took over. Nobody writes to
a folder of somebody else, dead or alive; so that even a lock that was lost cannot mix two trainings.
"""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from assemblyhands_core.data.locks import locked

CHECKPOINT: Final = "last.ckpt"
"""All that a training goes on from; it is replaced as a whole."""


@contextmanager
def own_folder(computation: Path) -> Iterator[Path]:
    """Give a new folder in that of a computation, with a copy of the newest checkpoint that others have left there."""
    computation.mkdir(parents=True, exist_ok=True)
    own = computation / uuid.uuid4().hex
    with locked(_lock_of(own)):  # before the folder is there, so that nobody finds it without its lock
        own.mkdir()
        for other in _newest_first(computation):
            if _copy(other, own):
                _remove_if_idle(other)
                break
        yield own


def remove_idle(computation: Path) -> None:
    """Remove the folders of a computation whose result is there, but for those in which somebody is at work."""
    for folder in [path for path in computation.glob("*") if path.is_dir()]:
        _remove_if_idle(folder)
    with suppress(OSError):  # it is not empty, or was never there
        computation.rmdir()


def _lock_of(folder: Path) -> Path:
    """Return a folder's lock, which lies beside it: NFS could not remove it with the folder while it is held."""
    return folder.with_name(f"{folder.name}.lock")


def _remove_if_idle(folder: Path) -> None:
    with suppress(OSError), locked(_lock_of(folder)):
        shutil.rmtree(folder)
        _lock_of(folder).unlink(missing_ok=True)


def _newest_first(computation: Path) -> list[Path]:
    return [path.parent for path in sorted(computation.glob(f"*/{CHECKPOINT}"), key=_changed_ns, reverse=True)]


def _changed_ns(path: Path) -> int:
    with suppress(OSError):  # its owner has just ended
        return path.stat().st_mtime_ns
    return 0


def _copy(other: Path, own: Path) -> bool:
    """Copy curves, and a checkpoint with its time, as it is not newer than the original; return whether it came off.

    A folder is not renamed though its owner seems to have ended: on NFS one that has not would go on writing to it.
    """
    partial = own / f".{CHECKPOINT}"
    try:
        shutil.copytree(other, own, ignore=shutil.ignore_patterns(".*", CHECKPOINT), dirs_exist_ok=True)
        shutil.copy2(other / CHECKPOINT, partial)
        partial.replace(own / CHECKPOINT)  # whole, or not at all
    except OSError:  # its owner has just ended, or on NFS replaced it while it was read
        return False
    return True
