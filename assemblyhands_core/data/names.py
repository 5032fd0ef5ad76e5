"""Names that Assembly101 and AssemblyHands give to recordings and egocentric cameras (formats 1.2, 2.4, 3.1)."""

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePosixPath
from typing import Final

from assemblyhands_core.data.json_files import FormatError, kind_of

_RECORDING: Final = re.compile(
    r"nusar-2021_action_both_(\d{4})-([abc]\d{2}[a-z]?)_(\d{4})_user_id_(\d{4}-\d{2}-\d{2}_\d{6})", re.ASCII
)
_STARTED: Final = "%Y-%m-%d_%H%M%S"
_EGO: Final = re.compile(r"(?:HMC_)?(\d{8})(?:[_:]mono10bit)?", re.ASCII)
_MAX_PART_BYTES: Final = 120  # half of what file systems take
_COMPONENT: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,254}", re.ASCII)


@dataclass(frozen=True, order=True)
class RecordingName:
    """What the name of a recording says; `str` gives the name.

    Attributes:
        participant: Number of the person.
        toy: Letter of the kind of toy, number and, for some, a letter: a23, c10a.
        started: Day and time at which the recording began, to the second.
        user: Number after the toy; the participant's but for typing errors in a few real names.
    """

    participant: int
    toy: str
    started: datetime
    user: int

    def __post_init__(self) -> None:
        """Refuse parts that make no name of the pattern."""
        if not _RECORDING.fullmatch(str(self)):
            raise ValueError(
                f"{str(self)!r} is no recording name: participants have four digits, toys look like a23 or c10a."
            )

    def __str__(self) -> str:
        """Return the name."""
        started = f"{self.started.year:04d}{self.started:-%m-%d_%H%M%S}"
        return f"nusar-2021_action_both_{self.participant:04d}-{self.toy}_{self.user:04d}_user_id_{started}"

    @property
    def day_seed(self) -> int:
        """The recording day as a number, 20310502: cameras are calibrated once a day."""
        return int(f"{self.started.year:04d}{self.started:%m%d}")


def recording_name(participant: int, toy: str, started: datetime) -> str:
    """Return the name of a recording.

    Raises:
        ValueError: The parts make no name of the pattern.
    """
    return str(RecordingName(participant, toy, started, participant))


def parse_recording_name(name: str) -> RecordingName:
    """Return the parts of a recording's name.

    Raises:
        ValueError: The name does not follow the pattern, or its date is none of the calendar.
    """
    if not (found := _RECORDING.fullmatch(name)):
        raise ValueError(
            f"{name!r} is no recording name: expected nusar-2021_action_both_<PPPP>-<toy>_<PPPP>_user_id_<date>_<time>."
        )
    participant, toy, user, started = found.groups()
    try:
        return RecordingName(int(participant), toy, datetime.strptime(started, _STARTED), int(user))
    except ValueError as error:
        raise ValueError(f"{name!r} is no recording name: {started} is no date with time of day.") from error


def ego_serial(name: str) -> str | None:
    """Return the eight digits of an egocentric camera's name in any of its spellings, None for any other camera."""
    found = _EGO.fullmatch(name)
    return found.group(1) if found else None


def ego_calibration_name(name: str) -> str:
    """Return how calibration files spell an egocentric camera: 84355350_mono10bit."""
    return f"{_known_serial(name)}_mono10bit"


def ego_video_name(name: str) -> str:
    """Return how videos and `ego_calib` spell an egocentric camera: HMC_84355350_mono10bit."""
    return f"HMC_{_known_serial(name)}_mono10bit"


def ego_image_name(name: str) -> str:
    """Return how the images of `ego_data` spell an egocentric camera: HMC_84355350."""
    return f"HMC_{_known_serial(name)}"


def checked_component(name: object, what: str) -> str:
    """Return a name that is safe as one component of a path.

    Args:
        name: As read from a file.
        what: What it names and where it was read, for the message.

    Raises:
        FormatError: It is no string, empty, or could leave its folder.
    """
    if not isinstance(name, str) or not _COMPONENT.fullmatch(name):
        raise FormatError(
            f"{what} is {kind_of(name)}: it becomes part of file names, so use letters, digits, - _ and ."
        )
    return name


def checked_relative_path(path: object, what: str) -> str:
    """Return a relative path whose every component is safe; arguments and errors as of `checked_component`."""
    if not isinstance(path, str) or not path or path != str(PurePosixPath(path)):
        raise FormatError(f"{what} is {kind_of(path)}: give a plain relative path like folder/file.")
    for part in path.split("/"):
        checked_component(part, f"{what} is {kind_of(path)}, in which a part")
    return path


def is_file_part(name: str) -> bool:
    """Return whether a name, in whatever language, can be a part of file names and nothing but that."""
    is_short = 0 < len(name.encode(errors="replace")) <= _MAX_PART_BYTES
    return is_short and name.isprintable() and not name.startswith(".") and not {"/", "\\"} & set(name)


def _known_serial(name: str) -> str:
    serial = ego_serial(name)
    if serial is None:
        raise ValueError(f"{name!r} names no egocentric camera: expected eight digits, as in HMC_84355350_mono10bit.")
    return serial
