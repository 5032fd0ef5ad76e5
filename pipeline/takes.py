"""Which synthetic sequences are to be recorded, and which still are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.layout import DatasetLayout
from pipeline.config import RunConfig, UserError
from pipeline.dag import TAKE_EDGE
from pipeline.manifests import ManifestRow, select_rows

STUDIO_PACKAGE: Final = "synthetic"
"""What manifests call the recordings of the studio."""
CROPS_PACKAGE: Final = "crops"
"""What manifests call crops that the studio draws directly, for training."""

_ORDERED: Final = (STUDIO_PACKAGE, CROPS_PACKAGE)


@dataclass(frozen=True)
class OrderedTake:
    """A synthetic sequence as a manifest orders it."""

    sequence_id: str
    split: str
    rig: str
    duration_s: float
    keypoints: None = None

    def origin_rows(self, digests: FileDigests) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        """Return the row of the ``takes`` table, by its edge; no file is read."""
        names = ("sequence_id", "split", "rig", "duration_s")
        return {TAKE_EDGE: ({name: getattr(self, name) for name in names},)}


def studio_folder(workspace: Path) -> Path:
    """Return the folder in which the studio's recordings lie, laid out like the real data sets."""
    return workspace / "synthetic"


def select_takes(config: RunConfig) -> list[OrderedTake]:
    """Return the synthetic sequences that ``seq`` names.

    Raises:
        UserError: a sequence is a real one, or its row does not say what to record.
    """
    rows = select_rows(config)
    if real := [row["sequence_id"] for row in rows if row["package"] not in _ORDERED]:
        raise UserError(f"{', '.join(real)}: real recordings cannot be simulated; choose sequences of synthetic_*.csv")
    return [_take(row) for row in rows]


def absent_takes(config: RunConfig) -> list[str]:
    """Return the names of the synthetic sequences that a run needs and that are not recorded yet."""
    if config.rig.calibration is not None:
        return []
    layout = DatasetLayout(studio_folder(config.workspace))
    rows = [row for row in select_rows(config) if row["package"] == STUDIO_PACKAGE]
    return [row["sequence_id"] for row in rows if not layout.delivered(row["sequence_id"]).is_file()]


def _take(row: ManifestRow) -> OrderedTake:
    name = row["sequence_id"]
    try:
        duration_s = float(row["duration_s"])
    except ValueError:
        raise UserError(f"sequence {name}: the manifest's duration_s is {row['duration_s']!r}, no number") from None
    if row["rig"] not in ("assembly", "desktop") or not 0 < duration_s <= 10**6:
        raise UserError(f"sequence {name}: rig has to be assembly or desktop, duration_s above 0 and at most 1e6")
    return OrderedTake(name, row["split"], row["rig"], duration_s)
