"""A certificate for one run: in the workspace, which all machines share, and for the user alone."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from pipeline.config import UserError

_ROLES: Final = ("scheduler", "worker", "client")


@contextmanager
def run_credentials(workspace: Path) -> Iterator[Path]:
    """Give a folder with a certificate and its key, and remove it afterwards.

    Raises:
        UserError: a package is missing.
    """
    from distributed.security import Security

    try:
        made = Security.temporary()
    except ImportError as error:
        raise UserError("certificates for this run need a package: .venv/bin/pip install -e '.[cluster]'") from error
    folder = workspace / "tls" / uuid.uuid4().hex
    folder.mkdir(parents=True, mode=0o700)
    try:
        for path, text in zip(_pair(folder), (made.tls_scheduler_cert, made.tls_scheduler_key), strict=True):
            path.touch(mode=0o600)
            path.write_text(text)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def tls_settings(folder: Path) -> dict[str, Any]:
    """Return Dask's settings for a certificate that everybody in the run has, and nobody else."""
    cert, key = map(str, _pair(folder))
    of_roles = {
        f"distributed.comm.tls.{role}.{name}": path for role in _ROLES for name, path in (("cert", cert), ("key", key))
    }
    return {"distributed.comm.tls.ca-file": cert, "distributed.comm.require-encryption": True, **of_roles}


def _pair(folder: Path) -> tuple[Path, Path]:
    return folder / "cert.pem", folder / "key.pem"
