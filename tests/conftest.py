"""Fixtures that every test folder may use."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
if "PYTEST_XDIST_WORKER" in os.environ:  # one of several processes that share the cores: it takes one of them
    os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))  # for the modules beside this one, which folders share

# From here on, before its first import, what the core takes and returns is held against the types and shapes that it
# states. In this process alone: what tests start runs as users run it.
jaxtyping.install_import_hook("assemblyhands_core", "type_checks.check")


@pytest.fixture
def unchecked_types() -> Iterator[None]:
    """Switch the checks of types and shapes off: this test is about how the code itself refuses what they forbid."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def _shared_folder(variable: str, default: str) -> Path:
    folder = Path(os.environ.get(variable, REPOSITORY.parent / "shared" / default))
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set {variable} to a folder with the reference data to run this test")
    return folder


@pytest.fixture(scope="session")
def golden_dir() -> Path:
    """Folder with the numbers that reference programs produced."""
    return _shared_folder("ASSEMBLYHANDS_GOLDEN", "golden")


@pytest.fixture(scope="session")
def calibration_dir() -> Path:
    """Folder with real Assembly101 calibrations; input for tests only."""
    return _shared_folder("ASSEMBLYHANDS_CALIBRATIONS", "assembly101_calib")
