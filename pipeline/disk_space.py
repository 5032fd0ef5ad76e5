"""Whether there is room for what a plan will make, before hours are spent on filling the disk."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pipeline.config import UserError
from pipeline.plan import PlannedNode, total_bytes

_GB: Final = 1e9


def check_space(workspace: Path, rows: Sequence[PlannedNode]) -> None:
    """Check that the plan fits on the workspace's disk, by what its nodes took in earlier runs.

    Raises:
        UserError: It does not.
    """
    needed, free = total_bytes(rows), shutil.disk_usage(workspace).free
    if needed > free:
        raise UserError(
            f"this run will take about {needed / _GB:.1f} GB, by what earlier ones took, and {workspace} has "
            f"{free / _GB:.1f} GB left: run `make gc`, or give workspace=PATH on a larger disk (check_space=false runs "
            "all the same; a full disk loses nothing)"
        )


def space_sentence(workspace: Path, rows: Sequence[PlannedNode]) -> str:
    """Say how much room a plan will take."""
    return f"estimated room: {total_bytes(rows) / _GB:.1f} of {shutil.disk_usage(workspace).free / _GB:.1f} GB"
