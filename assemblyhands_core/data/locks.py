"""Locks between processes, and between hosts where the file system has them: NFS 4 has, and Lustre with ``flock``."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def locked(path: Path, *, exclusive: bool = True, waits: bool = False) -> Iterator[None]:
    """Hold a lock file, which is made if it is not there. The lock falls with the process.

    Args:
        path: The file.
        exclusive: Nobody else holds it; otherwise others may share it.
        waits: Until it is free.

    Raises:
        BlockingIOError: Somebody else holds it, and this does not wait.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)  # NFS locks only what is open for writing
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | (0 if waits else fcntl.LOCK_NB))
        try:
            yield
        finally:
            fcntl.flock(descriptor, fcntl.LOCK_UN)  # closing is not enough: forked children have the file open, too
    finally:
        os.close(descriptor)
