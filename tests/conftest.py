"""Fixtures that every test folder may use."""

import os
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(Path(__file__).parent))  # for tiny_recording and command_line, which folders share


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
