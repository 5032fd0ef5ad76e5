"""Numbered clips, encoded once for all tests of videos."""

from collections.abc import Callable
from pathlib import Path

import pytest
from numbered_videos import GOPS, write_numbered


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """A numbered clip by GOP structure and container, encoded once."""
    folder, made = tmp_path_factory.mktemp("clips"), {}

    def get(gop: str, suffix: str = "mp4") -> Path:
        if (gop, suffix) not in made:
            made[gop, suffix] = write_numbered(folder / f"{gop}.{suffix}", GOPS[gop])
        return made[gop, suffix]

    return get
