"""What of the AssemblyHands release is there, recording by recording, before hours are spent on it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from assemblyhands_core.data.assemblyhands import read_ego_calibration, read_joint_annotations
from assemblyhands_core.data.assemblyhands_images import EgoImage, read_ego_images
from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.rigs import read_calibration
from pipeline.config import RunConfig, UserError
from pipeline.manifests import ManifestRow, select_rows
from pipeline.recordings import RELEASE_PACKAGE, release_folder
from pipeline.terminal import say

_MAX_SENTENCES = 20


@dataclass
class Findings:
    """What is there of one recording, and one sentence for each thing that is not as it should be."""

    sequence_id: str
    split: str
    num_fixed_cameras: int = 0
    num_videos: int = 0
    num_annotated: int = 0
    num_posed: int = 0
    num_listed: int = 0
    num_images: int = 0
    problems: list[str] = field(default_factory=list)


def preflight(config: RunConfig, console: Console) -> int:
    """Print what is there; return 0 if that is everything, else 1.

    Raises:
        UserError: a sequence is not of the release, or nobody says where that lies.
    """
    rows = select_rows(config)
    if odd := next((row for row in rows if row["package"] != RELEASE_PACKAGE), None):
        raise UserError(f"{odd['sequence_id']} is not of the release: manifest=data_manifests/assemblyhands_v1_1.csv")
    found = look_over(rows, release_folder(config))
    _print(console, found)
    return 1 if any(one.problems for one in found) else 0


def look_over(rows: list[ManifestRow], layout: DatasetLayout) -> list[Findings]:
    """Return what is there of each row's recording; a file of a split is read once."""
    read = cache(_readable)
    return [_findings(row, layout, read) for row in rows]


def _findings(row: ManifestRow, layout: DatasetLayout, read: Callable[..., Any]) -> Findings:
    found = Findings(row["sequence_id"], row["split"])
    calibration = layout.exo_calibration(found.sequence_id)
    found.num_fixed_cameras = len(_note(found, read(read_calibration, calibration)))
    found.num_videos = len(list(calibration.parent.glob("*.mp4")))
    if found.num_videos < found.num_fixed_cameras:
        found.problems.append(f"{calibration.parent}: {found.num_videos} of {found.num_fixed_cameras} videos")
    joints = _own(found, layout.annotations(found.split, "joint_3d"), read, read_joint_annotations)
    poses = _own(found, layout.annotations(found.split, "ego_calib"), read, read_ego_calibration)
    found.num_annotated, found.num_posed = (len(part.frames_60hz) if part else 0 for part in (joints, poses))
    listing = layout.annotations(found.split, "ego_data")
    images = [image for image in _note(found, read(read_ego_images, listing)) if image.recording == found.sequence_id]
    _count_images(found, images, layout.images)
    return found


def _readable(reader: Callable[[Path], Any], path: Path) -> tuple[Any, str]:
    """Return what a file holds, empty and a sentence if it cannot be read."""
    if not path.is_file():
        return {}, f"{path}: is not there"
    try:
        return reader(path), ""
    except (FormatError, ValueError, OSError) as error:
        return {}, str(error)


def _note(found: Findings, result: tuple[Any, str]) -> Any:
    content, problem = result
    if problem:
        found.problems.append(problem)
    return content


def _own(found: Findings, path: Path, read: Callable[..., Any], reader: Callable[[Path], Mapping[str, Any]]) -> Any:
    result = read(reader, path)
    content = _note(found, result)
    if not result[1] and found.sequence_id not in content:
        found.problems.append(f"{path}: has nothing of this recording")
    return content.get(found.sequence_id)


def _count_images(found: Findings, images: list[EgoImage], folder: Path) -> None:
    missing = [image.file_name for image in images if not (folder / image.file_name).is_file()]
    found.num_listed, found.num_images = len(images), len(images) - len(missing)
    if missing:
        found.problems.append(f"{folder / missing[0]}: is not there, nor are {len(missing) - 1} more of the pictures")


def _print(console: Console, found: list[Findings]) -> None:
    table = Table("recording", "split", "fixed cameras", "videos", "annotated", "posed", "pictures")
    for one in found:
        counts = (one.num_fixed_cameras, one.num_videos, one.num_annotated, one.num_posed)
        pictures = f"{one.num_images} of {one.num_listed}"
        table.add_row(one.sequence_id, one.split, *map(str, counts), pictures)
    console.print(table)
    sentences = list(dict.fromkeys(sentence for one in found for sentence in one.problems))
    for sentence in sentences[:_MAX_SENTENCES]:
        say(console, sentence)
    if len(sentences) > _MAX_SENTENCES:
        say(console, f"and {len(sentences) - _MAX_SENTENCES} more")
