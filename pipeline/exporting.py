"""Write a run's annotations in the forms that others read: AssemblyHands and COCO files, with their QA mask beside.

The folder is laid out like the AssemblyHands release, so that its reader, and ours, take it: ``release=<run>/export``.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from rich.console import Console

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.assemblyhands import (
    KEYS_PER_VIDEO_FRAME,
    EgoCalibration,
    JointAnnotations,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.assemblyhands_images import EgoImage, ego_image_file, read_ego_images, write_ego_images
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.coco_keypoints import CocoHand, CocoPicture, write_coco_keypoints
from assemblyhands_core.data.hands2023 import write_submission
from assemblyhands_core.data.label_rows import FROM_FIRST_KEY, first_key_of, keys_per_frame, read_recording
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.store import load_table
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS
from pipeline.config import RunConfig
from pipeline.publishing import lay_out
from pipeline.recordings import Recording, select_recordings
from pipeline.terminal import say

TARGET: Final = "export"
PREDICTION: Final = "predict"
_NO_SPLIT: Final = "all"


@dataclass(frozen=True, eq=False)
class _Exported:
    """One recording's part of the files.

    Attributes:
        first_key, step: 60 Hz key of frame 0, and keys between frames.
    """

    recording: Recording
    first_key: int
    step: int
    joints: pa.Table
    pictures: pa.Table | None

    @property
    def name(self) -> str:
        return self.recording.sequence_id

    @property
    def split(self) -> str:
        return self.recording.split or _NO_SPLIT

    def keys(self, frames: Any) -> Any:
        """Return the 60 Hz keys of frames."""
        return self.first_key + self.step * np.asarray(frames, dtype=np.int64)


def write_export(console: Console, config: RunConfig, run: Path) -> None:
    """Write the files of a run that was asked to export, and say where.

    Args:
        console: Where that is said.
        config: Of the run.
        run: Its folder.
    """
    if config.target == TARGET:
        folder = export(run, select_recordings(config), config.rounds)
        say(console, f"exported: {folder}")


def write_hands2023(console: Console, config: RunConfig, run: Path) -> None:
    """Fill the HANDS2023 template with what a run predicted, if it was given one, and say where the file is."""
    if config.hands2023_template is None or config.target != PREDICTION:
        return
    folder = run / "submission"
    folder.mkdir(exist_ok=True)
    predicted = {recording.sequence_id: _both_hands(recording, run) for recording in select_recordings(config)}
    archive, problems = write_submission(config.hands2023_template, predicted, folder)
    for sentence in (*problems, f"submission: {archive}"):
        say(console, sentence)


def _both_hands(recording: Recording, run: Path) -> dict[int, Any]:
    """Return a recording's predicted joints (42, 3) in the world by 60 Hz key."""
    joints = _of(run / "predict_manual", "joints", recording.sequence_id)
    if joints is None or not joints.num_rows:
        return {}
    part = _Exported(recording, _first_key(recording), KEYS_PER_VIDEO_FRAME, joints, None)
    found = _annotations(part)
    return dict(zip(found.frames_60hz.tolist(), found.joints_world_mm.reshape(-1, NUM_BOTH, 3), strict=True))


def export(run: Path, recordings: Sequence[Recording], last_round: int) -> Path:
    """Write the files of a run's recordings; return their folder.

    Args:
        run: Its folder.
        recordings: Which it is about.
        last_round: Whose joints are exported.
    """
    layout = DatasetLayout(run / "export")
    found = [part for recording in recordings for part in _exported(recording, run, last_round)]
    for split in sorted({part.split for part in found}):
        parts = [part for part in found if part.split == split]
        _write_split(layout, split, parts)
    for part in found:
        _write_mask(layout, part)
    layout.root.mkdir(exist_ok=True)
    shutil.copy(run / "run.json", layout.root / "provenance.json")
    return layout.root


def _exported(recording: Recording, run: Path, last_round: int) -> Iterator[_Exported]:
    joints = _of(run / f"round_{last_round}", "joints", recording.sequence_id)
    if joints is None or not joints.num_rows:
        return
    views = _of(run / "ingest", "views", recording.sequence_id)
    rate_hz = float(views.filter(pc.field("valid"))["rate_hz"][0].as_py()) if views is not None else 30.0
    pictures = _of(run / "ego_pictures", "pictures", recording.sequence_id)
    yield _Exported(recording, _first_key(recording), keys_per_frame(rate_hz), joints, pictures)


def _first_key(recording: Recording) -> int:
    """Return the 60 Hz key of a recording's frame 0: see `stages/ingest_ego.py`."""
    if recording.label_name != FROM_FIRST_KEY:
        return 0
    if recording.labels is not None:
        source = {"source_file": str(recording.labels), "name": recording.label_name}
        return first_key_of(source, read_recording(source, recording.sequence_id))
    images = read_ego_images(recording.ego_images) if recording.ego_images is not None else []
    return min((image.frame_60hz for image in images if image.recording == recording.sequence_id), default=0)


def _of(node: Path, table: str, sequence_id: str) -> pa.Table | None:
    """Return a recording's rows of a table, None where the run has no such node."""
    if not (node / "manifest.json").is_file() or not any((node / table).glob("*.parquet")):
        return None
    return load_table(node, table).filter(pc.field("sequence_id") == sequence_id)


def _write_split(layout: DatasetLayout, split: str, parts: list[_Exported]) -> None:
    write_joint_annotations(layout.annotations(split, "joint_3d"), {part.name: _annotations(part) for part in parts})
    worn = [part for part in parts if part.pictures is not None and part.pictures.num_rows]
    if worn:
        write_ego_calibration(layout.annotations(split, "ego_calib"), {part.name: _calibration(part) for part in worn})
        rows = [(part, row) for part in worn for row in _rows(part)]
        images = [_image(part, row) for part, row in rows]
        write_ego_images(layout.annotations(split, "ego_data"), images)
        coco = [_coco(row, image.file_name) for (_, row), image in zip(rows, images, strict=True)]
        write_coco_keypoints(layout.annotations(split, "ego_data").with_name(f"coco_hands_{split}.json"), coco)
        for (_, row), image in zip(rows, images, strict=True):
            lay_out(Path(row["picture_file"]), layout.images / image.file_name)


def _annotations(part: _Exported) -> JointAnnotations:
    frames = np.unique(to_numpy(part.joints["frame"]))
    world = np.full((len(frames), len(HANDS), NUM_JOINTS, 3), np.nan)
    place = np.searchsorted(frames, to_numpy(part.joints["frame"]))
    hand = [HANDS.index(name) for name in part.joints["hand"].to_pylist()]
    world[place, hand] = joints_or_nan(part.joints)
    return JointAnnotations(part.keys(frames), world, np.isfinite(world).all(axis=-1))


def _rows(part: _Exported) -> list[dict[str, Any]]:
    """Return the pictures' rows with arrays, by frame and camera."""
    assert part.pictures is not None
    return sorted(part.pictures.to_pylist(), key=lambda row: (row["frame"], row["camera_id"]))


def _calibration(part: _Exported) -> EgoCalibration:
    assert part.pictures is not None
    table = part.pictures
    names, frames = sorted(set(table["camera_id"].to_pylist())), np.unique(to_numpy(table["frame"]))
    poses = np.full((len(frames), len(names), 4, 4), np.nan)
    place = np.searchsorted(frames, to_numpy(table["frame"]))
    camera = [names.index(name) for name in table["camera_id"].to_pylist()]
    poses[place, camera] = to_numpy(table["T_camera_from_world"]).reshape(-1, 4, 4)
    first = [table.filter(pc.field("camera_id") == name).slice(0, 1).to_pylist()[0] for name in names]
    return EgoCalibration(tuple(names), np.stack([camera_from_row(row).K for row in first]), part.keys(frames), poses)


def _image(part: _Exported, row: Mapping[str, Any]) -> EgoImage:
    key = int(part.keys(row["frame"]))
    boxes = np.reshape(row["box_px"], (len(HANDS), 4))
    known = np.isfinite(np.reshape(row["joints_px"], (len(HANDS), NUM_JOINTS, 2))).all(axis=-1)
    return EgoImage(
        recording=part.name,
        camera_id=row["camera_id"],
        frame_60hz=key,
        file_name=ego_image_file(part.split, part.name, row["camera_id"], key),
        size_px=(row["width_px"], row["height_px"]),
        box_px={hand: _corners(box) for hand, box in zip(HANDS, boxes, strict=True) if np.isfinite(box).all()},
        is_valid=np.asarray(known),
    )


def _coco(row: Mapping[str, Any], file_name: str) -> CocoPicture:
    boxes = np.reshape(row["box_px"], (len(HANDS), 4))
    pixels = np.reshape(row["joints_px"], (len(HANDS), NUM_JOINTS, 2)).astype(np.float64)
    labelled = np.reshape(row["is_labelled"], (len(HANDS), NUM_JOINTS)).astype(bool)
    hands = tuple(
        CocoHand(hand, px, flags, _corners(box))
        for hand, px, flags, box in zip(HANDS, pixels, labelled, boxes, strict=True)
        if np.isfinite(box).all()
    )
    return CocoPicture(file_name, (row["width_px"], row["height_px"]), hands)


def _corners(box: Any) -> tuple[float, float, float, float]:
    left, top, right, bottom = (float(value) for value in box)
    return left, top, right, bottom


def _write_mask(layout: DatasetLayout, part: _Exported) -> None:
    """Write why each joint is valid or not, by how many views and how well it fits, beside the annotations."""
    path = layout.annotations(part.split, "joint_3d").with_name(f"qa_{part.name}.parquet")
    keys = pa.array(part.keys(to_numpy(part.joints["frame"])))
    pq.write_table(part.joints.append_column("frame_60hz", keys), path)
