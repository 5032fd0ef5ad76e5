"""The file of 2D keypoints that people set by hand: CSV, a line for each joint in a view.

Pixels are of the camera's own video, with its lens's distortion, integers at pixel centres. Visibility as in COCO: 2
seen, 1 hidden but known, 0 not to be used (then without pixels).
"""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.corrections import NOT_SEEN
from assemblyhands_core.data.csv_files import opened_csv
from assemblyhands_core.data.drafts import replaced_whole
from assemblyhands_core.data.json_files import FormatError, counted_problems, kind_of
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, JOINT_NAMES

_VISIBILITIES: Final = ("0", "1", "2")
_MAX_BYTES: Final = 2**27  # of a million joints and more
_MAX_DIGITS: Final = 9


@dataclass(frozen=True, order=True)
class Correction:
    """One joint of a hand in a view, set by hand.

    Attributes:
        x_px, y_px: In the view's video; NaN where it is not seen.
        visibility: 2 seen, 1 hidden, 0 not to be used.
    """

    sequence_id: str
    frame: int
    camera_id: str
    hand: str
    joint: str
    x_px: float
    y_px: float
    visibility: int

    @property
    def key(self) -> tuple[int, str, str, str]:
        """Return what it is about."""
        return self.frame, self.camera_id, self.hand, self.joint


COLUMNS: Final = tuple(field.name for field in fields(Correction))


def read_corrections(path: Path) -> list[Correction]:
    """Read a file.

    Raises:
        FormatError: It is not as it should be; the message says what, in which line, and how many lines are wrong.
    """
    found: dict[tuple[int, str, str, str], Correction] = {}
    with opened_csv(path, _MAX_BYTES, strict=True) as reader, counted_problems() as problems:
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise FormatError(f"{path}: wrong_columns: its first line has to be {','.join(COLUMNS)}")
        for row in reader:
            with problems.noted():
                where = f"{path}: line {reader.line_num}"
                correction = _correction(row, where)
                if correction.key in found:
                    raise FormatError(f"{where}: repeated_joint: {_name(correction)} stands there twice")
                found[correction.key] = correction
    return list(found.values())


def write_corrections(path: Path, corrections: Iterable[Correction]) -> None:
    """Write a file whole, in order, so that equal corrections make equal files."""
    with replaced_whole(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for correction in sorted(corrections, key=lambda c: c.key):
            writer.writerow(["" if value != value else value for value in astuple(correction)])


def check_corrections(
    name: str, corrections: Sequence[Correction], sequence_id: str, views: Mapping[str, Camera], num_frames: int
) -> None:
    """Hold corrections against the recording that they are about.

    Args:
        name: Of their file, for messages.
        corrections: What to look at.
        sequence_id: The recording.
        views: Its usable cameras.
        num_frames: How many instants of it are annotated.

    Raises:
        FormatError: One is about another recording, an unknown view or frame, or lies outside its picture.
    """
    with counted_problems() as problems:
        for correction in corrections:
            with problems.noted():
                if problem := _problem(correction, sequence_id, views, num_frames):
                    raise FormatError(f"{name}: {_name(correction)}: {problem}")


def _problem(correction: Correction, sequence_id: str, views: Mapping[str, Camera], num_frames: int) -> str:
    camera = views.get(correction.camera_id)
    if correction.sequence_id != sequence_id:
        return f"wrong_sequence: it is of {correction.sequence_id}, the recording is {sequence_id}"
    if not 0 <= correction.frame < num_frames:
        return f"unknown_frame: the frames that are annotated are 0 to {num_frames - 1}"
    if camera is None:
        return f"unknown_view: the recording's usable views are {', '.join(views)}"
    x, y, width, height = correction.x_px, correction.y_px, camera.width_px, camera.height_px
    if correction.visibility != NOT_SEEN and not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        return f"outside_picture: ({x:.1f}, {y:.1f}) is not in a picture of {width}x{height}"
    return ""


def _correction(row: Mapping[str | None, Any], where: str) -> Correction:
    if None in row or None in row.values():
        raise FormatError(f"{where}: wrong_count: there are {len(COLUMNS)} columns, {', '.join(COLUMNS)}")
    frame, hand, joint, visibility = (row[name] for name in ("frame", "hand", "joint", "visibility"))
    if not (frame.isascii() and frame.isdigit() and len(frame) <= _MAX_DIGITS):
        raise FormatError(f"{where}: unknown_frame: {kind_of(frame)} is no frame; they count from 0")
    if hand not in HANDS:
        raise FormatError(f"{where}: unknown_hand: {kind_of(hand)}; a hand is {' or '.join(HANDS)}")
    if joint not in JOINT_NAMES:
        raise FormatError(
            f"{where}: unknown_joint: {kind_of(joint)}; joints are called {JOINT_NAMES[0]} to {JOINT_NAMES[-1]}"
        )
    if visibility not in _VISIBILITIES:
        raise FormatError(f"{where}: unknown_visibility: {kind_of(visibility)}; 2 is seen, 1 hidden, 0 not to be used")
    is_seen = int(visibility) != NOT_SEEN
    x_px, y_px = (_pixel(row[name], is_seen, f"{where}: {name}") for name in ("x_px", "y_px"))
    return Correction(row["sequence_id"], int(frame), row["camera_id"], hand, joint, x_px, y_px, int(visibility))


def _pixel(text: str, is_seen: bool, where: str) -> float:
    try:
        value = float(text) if text or is_seen else math.nan
    except ValueError:
        value = math.nan
    if is_seen and not math.isfinite(value):
        raise FormatError(f"{where}: not_a_number: {kind_of(text)}; with visibility 1 or 2 a joint has a place")
    return value if is_seen else math.nan


def _name(correction: Correction) -> str:
    return f"{correction.hand} {correction.joint} in {correction.camera_id} at frame {correction.frame}"
