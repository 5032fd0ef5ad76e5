"""Where the files of a data set stand, real or synthetic, and which recordings each split has (formats 1-3)."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from assemblyhands_core.data.json_files import FormatError, read_bytes
from assemblyhands_core.data.names import checked_component, parse_recording_name

AnnotationKind = Literal["joint_3d", "ego_calib", "ego_data"]

_RELEASE = "v1-1"
_MAX_LIST_BYTES = 2**24


@dataclass(frozen=True)
class DatasetLayout:
    """The files of a data set below one folder.

    Attributes:
        root: The folder.
    """

    root: Path

    def calibration(self, recording: str) -> Path:
        """Return the calibration of a recording's cameras."""
        return self.root / "calib" / "nimble_json_calib" / f"{checked_component(recording, 'a recording')}.json"

    def video(self, recording: str, camera_id: str) -> Path:
        """Return a camera's raw video."""
        recording, camera_id = checked_component(recording, "a recording"), checked_component(camera_id, "a camera")
        return self.root / "recordings" / recording / f"{camera_id}.mp4"

    def annotations(self, split: str, kind: AnnotationKind) -> Path:
        """Return an AssemblyHands annotation file of a split: that of v1-1, or the only one of another version."""
        split = checked_component(split, "a split")
        path = self.root / "annotations" / split / f"assemblyhands_{split}_{kind}_{_RELEASE}.json"
        others = sorted(path.parent.glob(f"assemblyhands_{split}_{kind}_*.json"))
        return others[0] if len(others) == 1 else path

    @property
    def images(self) -> Path:
        """The folder in which the names of `ego_data` begin."""
        return self.root / "images"

    def ego_images(self, split: str, recording: str) -> Path:
        """Return the folder of a recording's rectified egocentric pictures."""
        split, recording = checked_component(split, "a split"), checked_component(recording, "a recording")
        return self.images / "ego_images_rectified" / split / recording

    @property
    def skeleton(self) -> Path:
        """The names and parents of the joints."""
        return self.root / "annotations" / "skeleton.txt"

    def exo_calibration(self, recording: str) -> Path:
        """Return the rectified exocentric cameras of a recording."""
        recording = checked_component(recording, "a recording")
        return self.root / "videos" / "exo_videos_rectified" / recording / "calib.txt"

    def fine_grained(self, split: str, rate_hz: Literal[30, 60]) -> Path:
        """Return the verb segments of a split, in the form that counts at 30 or at 60 fps."""
        return self.root / "fine-grained-annotations" / f"{rate_hz}fps" / f"{checked_component(split, 'a split')}.csv"

    @property
    def actions(self) -> Path:
        """The list of all actions."""
        return self.root / "fine-grained-annotations" / "actions.csv"

    def split(self, split: str) -> Path:
        """Return the list of a split's recordings."""
        return self.splits / f"{checked_component(split, 'a split')}.txt"

    @property
    def splits(self) -> Path:
        """The folder of the lists of all splits."""
        return self.root / "splits"

    def ground_truth(self, recording: str) -> Path:
        """Return the folder of what only evaluation may read of a recording."""
        return self.root / "ground_truth" / checked_component(recording, "a recording")

    def labels(self, recording: str) -> Path:
        """Return the folder of a synthetic recording's own share of the files that a split has in common."""
        return self.root / "labels" / checked_component(recording, "a recording")

    def delivered(self, recording: str) -> Path:
        """Return the list of a synthetic recording's files; it is there once they all are."""
        return self.root / "delivered" / f"{checked_component(recording, 'a recording')}.sha256"


def write_splits(layout: DatasetLayout, recordings: Mapping[str, Iterable[str]]) -> None:
    """Write which recordings each split has, one a line.

    Raises:
        ValueError: A person occurs in two splits, so that results would not be about unseen people.
    """
    splits = {split: sorted(names) for split, names in recordings.items()}
    check_splits(splits)
    for split, names in splits.items():
        path = layout.split(split)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def check_splits(recordings: Mapping[str, Iterable[str]]) -> None:
    """Check that every person is in one split, and every split's name can be part of file names.

    Raises:
        ValueError: One is not.
    """
    split_of_participant: dict[int, str] = {}
    for split, names in recordings.items():
        checked_component(split, "a split")
        for name in names:
            participant = parse_recording_name(name).participant
            if (other := split_of_participant.setdefault(participant, split)) != split:
                raise ValueError(f"participant {participant} occurs in the splits {other} and {split}; choose one.")


def read_split(path: Path) -> list[str]:
    """Read the recordings of a split.

    Raises:
        FormatError: The file cannot be read, or a line names no recording or one that was named before.
    """
    try:
        lines = [line.strip() for line in read_bytes(path, _MAX_LIST_BYTES).decode("utf-8").splitlines()]
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: is no text; get the file again.") from error
    names: dict[str, None] = {}
    for number, name in enumerate(lines, start=1):
        if not name:
            continue
        try:
            parse_recording_name(name)
        except ValueError as error:
            raise FormatError(f"{path}, line {number}: {error}") from error
        if name in names:
            raise FormatError(f"{path}, line {number}: {name} was named before; keep it once.")
        names[name] = None
    return list(names)
