"""Optional packages: import them or say how to install them."""

import importlib
import importlib.metadata
import importlib.util
from pathlib import Path
from typing import Any

from assemblyhands_core.detectors.base import DetectorError


def import_package(name: str, install: str) -> Any:
    """Return the imported package, or raise a DetectorError that says how to install it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise DetectorError(f"The package {name} cannot be imported ({error}); install it: {install}") from error


def package_folder(name: str, install: str) -> Path:
    """Return where a package lies, without importing it, or raise a DetectorError that says how to install it."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        raise DetectorError(f"The package {name} is not installed; install it: {install}")
    return Path(spec.origin).parent


def package_version(name: str, install: str) -> str:
    """Return the installed version, or raise a DetectorError that says how to install it."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError as error:
        raise DetectorError(f"The package {name} is not installed; install it: {install}") from error
