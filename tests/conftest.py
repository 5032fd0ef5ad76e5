"""Fixtures that every test folder may use."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest

# From here on what these modules take and return is held against the types and shapes that they state. An int passes
# for a float, as it does for mypy. Before the modules are imported for the first time, and in this process alone: what
# tests start runs as users run it.
jaxtyping.install_import_hook(
    [
        *(f"assemblyhands_core.{package}" for package in ("geometry", "hands", "detectors", "viz")),
        *(f"assemblyhands_core.data.{module}" for module in ("crop_images", "image_fit", "outcomes")),
    ],
    "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
)

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(Path(__file__).parent))  # for tiny_recording and command_line, which folders share


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
