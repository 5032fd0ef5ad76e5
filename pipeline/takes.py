"""Which synthetic sequences are ordered from the studio, and which are still to be recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.names import parse_recording_name
from assemblyhands_core.data.split_files import check_new_splits
from assemblyhands_core.synthetic.crop_draws import FIRST_SUBJECT
from assemblyhands_core.synthetic.rig import RIGS
from assemblyhands_core.synthetic.session import RATE_HZ
from pipeline.config import RunConfig, UserError
from pipeline.graph import CROP_EDGE, TAKE_EDGE
from pipeline.manifests import ManifestRow, select_rows
from stages.deliver_recording import STAGE as DELIVERY

STUDIO_PACKAGE: Final = "synthetic"
"""What manifests call the recordings of the studio."""
CROPS_PACKAGE: Final = "crops"
"""What manifests call crops that the studio draws directly, for training."""

HEADSET: Final = "headset"
"""What manifests call the studio's rig without fixed cameras."""

_MAX_DURATION_S: Final = 10**6
_LABELLED_EVERY_S: Final = 1.0  # not in the heading: so it is in the real data, and was before others could be ordered


@dataclass(frozen=True)
class OrderedTake:
    """A synthetic sequence as a manifest orders it: a recording, or a set of crops for training."""

    sequence_id: str
    split: str
    rig: str
    duration_s: float
    package: str
    rate_hz: int = RATE_HZ
    keypoints: None = None
    detector: ClassVar[str] = ""

    def origin_rows(self, digests: FileDigests) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        """Return the order's row by its edge; no file is read."""
        edge = CROP_EDGE if self.package == CROPS_PACKAGE else TAKE_EDGE
        return {TAKE_EDGE: (), CROP_EDGE: (), edge: (vars(self),)}

    def heading(self, config: RunConfig) -> str:
        """Return the first line of its list of delivered files: other orders and labels are other recordings."""
        rate = "" if self.rate_hz == RATE_HZ else f" rate_hz={self.rate_hz}"
        every_s = config.stages[DELIVERY.name].model_dump()["labelled_every_s"]
        labels = "" if every_s == _LABELLED_EVERY_S else f" labelled_every_s={every_s!r}"
        return f"# rig={self.rig} duration_s={self.duration_s!r}{rate} split={self.split}{labels}"


def studio_folder(workspace: Path) -> Path:
    """Return the folder in which the studio's recordings lie, laid out like the real data sets."""
    return workspace / "synthetic"


def select_takes(config: RunConfig) -> list[OrderedTake]:
    """Return the synthetic sequences that ``seq`` names.

    Raises:
        UserError: a sequence is a real one, its row does not say what to record, or its person is in another split.
    """
    takes = [_take(row, config) for row in select_rows(config)]
    recordings = {take.sequence_id: take.split for take in takes if take.package == STUDIO_PACKAGE}
    try:
        check_new_splits(DatasetLayout(studio_folder(config.workspace)), recordings)
    except ValueError as error:
        raise UserError(str(error)) from error
    return takes


def absent_takes(config: RunConfig) -> list[str]:
    """Return the names of the synthetic sequences that a run needs and that are not recorded as ordered."""
    if config.rig.calibration is not None or config.rig.videos is not None:
        return []  # files of one's own
    layout = DatasetLayout(studio_folder(config.workspace))
    takes = [_take(row, config) for row in select_rows(config) if row["package"] == STUDIO_PACKAGE]
    return [take.sequence_id for take in takes if not _is_delivered(layout, take.heading(config), take.sequence_id)]


def _is_delivered(layout: DatasetLayout, heading: str, recording: str) -> bool:
    listing = layout.delivered(recording)
    lines = listing.read_text(encoding="utf-8").splitlines() if listing.is_file() else []
    files = [layout.root / line.partition("  ")[2] for line in lines[1:]]
    return lines[:1] == [heading] and all(file.is_file() for file in files)


def _take(row: ManifestRow, config: RunConfig) -> OrderedTake:
    name = row["sequence_id"]
    wanted: Literal["synthetic", "crops"] = "crops" if config.starts_from_crops else "synthetic"
    if row["package"] != wanted:
        raise UserError(
            f"sequence {name} of {row['manifest']} is of the package {row['package'] or 'none'}, but "
            f"target={config.target} takes sequences of the package {wanted}"
        )
    if wanted == STUDIO_PACKAGE:
        _check_person(name, row["manifest"])
    if row["rig"] not in RIGS:
        known = ", ".join(RIGS)
        raise UserError(f"{row['manifest']}, sequence {name}: rig is {row['rig']!r}, has to be one of {known}")
    return OrderedTake(name, row["split"], row["rig"], _duration_s(row), row["package"], _rate_hz(row))


def _check_person(name: str, manifest: str) -> None:
    try:
        participant = parse_recording_name(name).participant
    except ValueError as error:
        raise UserError(f"{manifest}: {error}") from error
    if participant >= (first := min(FIRST_SUBJECT.values())):
        raise UserError(f"{manifest}: persons from {first} on are those of training crops; name {name} otherwise")


def _rate_hz(row: ManifestRow) -> int:
    """Return the frames a second that a row orders; 60 Hz keys have to name every frame."""
    rates = {str(rate): rate for rate in range(1, RATE_HZ + 1) if RATE_HZ % rate == 0}
    if (rate := rates.get(row["rate_hz"] or str(RATE_HZ))) is None:
        where = f"{row['manifest']}, sequence {row['sequence_id']}"
        raise UserError(f"{where}: rate_hz is {row['rate_hz']!r}, has to be one of {', '.join(rates)}")
    return rate


def _duration_s(row: ManifestRow) -> float:
    try:
        duration_s = float(row["duration_s"])
    except ValueError:
        duration_s = float("nan")
    if not 0 < duration_s <= _MAX_DURATION_S:
        where = f"{row['manifest']}, sequence {row['sequence_id']}"
        raise UserError(f"{where}: duration_s is {row['duration_s']!r}, has to be a number above 0, at most 1e6")
    return duration_s
