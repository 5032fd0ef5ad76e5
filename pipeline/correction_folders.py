"""A task's folder: ``work/corrections/<seq>/<tag>/`` with pictures, joints as given, and labels for CVAT."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.coco_keypoints import CocoPicture, read_coco_keypoints, write_coco_keypoints
from assemblyhands_core.data.correction_tasks import TaskPicture, as_given
from assemblyhands_core.data.csv_files import opened_csv
from assemblyhands_core.data.cvat_labels import cvat_labels
from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.json_files import FormatError, member
from assemblyhands_core.data.names import is_file_part
from assemblyhands_core.hands.joints import Hand
from pipeline.config import UserError

IMAGES: Final = "images"
_ANNOTATIONS: Final = "annotations/person_keypoints_default.json"  # as CVAT calls its own
_LABELS: Final = "cvat_labels.json"
_PICTURES: Final = "pictures.csv"
_SUSPECTS: Final = "suspects.csv"
_COLUMNS: Final = ("file_name", "sequence_id", "camera_id", "frame")
_MAX_BYTES: Final = 2**26
_MARK: Final = "--"
_TAG_LENGTH: Final = 8


def task_pictures(
    sequence_id: str, places: Sequence[tuple[str, int, tuple[int, int], Mapping[Hand, Any]]]
) -> list[TaskPicture]:
    """Return the pictures of a task, under names that tell tasks with other joints apart.

    Args:
        sequence_id: What they show.
        places: Camera, frame, width and height, and the joints (21, 2) to start from, for each.
    """
    given = [[camera, frame, *(px.round(2).tolist() for px in hands.values())] for camera, frame, _, hands in places]
    tag = digest_json([sequence_id, json.dumps(given)])[:_TAG_LENGTH]
    names = [f"{sequence_id}{_MARK}{camera}{_MARK}{frame:06d}{_MARK}{tag}.jpg" for camera, frame, _, _ in places]
    return [
        TaskPicture(name, sequence_id, camera, frame, as_given(name, size_px, hands))
        for name, (camera, frame, size_px, hands) in zip(names, places, strict=True)
    ]


def task_folder(corrections: Path, picture_name: str) -> Path:
    """Return the folder of the task that a picture is of, whatever folders a tool has put before its name.

    Raises:
        UserError: It has no such name.
    """
    sequence_id, _, rest = Path(picture_name).stem.partition(_MARK)
    _, mark, tag = rest.rpartition(_MARK)
    if not mark or not (is_file_part(sequence_id) and is_file_part(tag)):
        raise UserError(f"unknown_picture: {picture_name} is no picture of a task; leave their names as they are")
    return corrections / sequence_id / tag


def write_task(folder: Path, pictures: Sequence[TaskPicture], suspects: Iterable[Sequence[Any]]) -> None:
    """Write all of a task but its pictures' pixels; a suspect is frame, hand, severity and reasons."""
    write_coco_keypoints(folder / _ANNOTATIONS, [picture.start for picture in pictures])
    (folder / _LABELS).write_text(json.dumps(cvat_labels(), indent=1) + "\n", encoding="utf-8")
    rows = [(p.file_name, p.sequence_id, p.camera_id, p.frame) for p in pictures]
    _write_csv(folder / _PICTURES, _COLUMNS, rows)
    _write_csv(folder / _SUSPECTS, ("frame", "hand", "severity", "reasons"), suspects)


def read_task(folder: Path) -> dict[str, TaskPicture]:
    """Return the pictures of a task as they were given, by name.

    Raises:
        UserError: The folder is not there.
        FormatError: A file in it is not as it was written.
    """
    if not (folder / _PICTURES).is_file():
        raise UserError(
            f"unknown_picture: there is no task {folder}; import where it was exported, or corrections=PATH"
        )
    start = {picture.file_name: picture for picture in read_coco_keypoints(folder / _ANNOTATIONS)}
    with opened_csv(folder / _PICTURES, _MAX_BYTES, restval="") as reader:
        rows = [(row, f"{folder / _PICTURES}: line {reader.line_num}") for row in reader]
    return {row["file_name"]: _task_picture(row, start, folder.parent.name, where) for row, where in rows}


def _task_picture(
    row: Mapping[str, str], start: Mapping[str, CocoPicture], sequence_id: str, where: str
) -> TaskPicture:
    name, sequence, camera_id, frame = (member(row, column, where) for column in _COLUMNS)
    if sequence != sequence_id or name not in start or not (frame.isascii() and frame.isdigit() and len(frame) < 10):
        raise FormatError(f"{where}: is no picture of {sequence_id} as it was exported; export the task again.")
    return TaskPicture(name, sequence_id, camera_id, int(frame), start[name])


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([columns, *rows])
