"""``python -m pipeline suspects``: the hands of a run that are probably wrong, as tasks for annotation tools."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from rich.console import Console

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import HAND_BOXES, JOINTS, KEYPOINTS, RESIDUALS, ROUNDS, VIEWS
from assemblyhands_core.data.correction_tasks import TaskPicture
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.suspects import Suspect, choose_suspects, find_suspects
from assemblyhands_core.data.video import VideoError, VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand
from pipeline.config import RunConfig, UserError
from pipeline.correction_folders import IMAGES, task_folder, task_pictures, write_task
from pipeline.finished import FinishedRun, open_run
from pipeline.round_crops import round_nodes
from pipeline.sequence_tables import SequenceTables, chosen_sequences
from pipeline.terminal import say

_SHOWN = 5

Floats = npt.NDArray[np.floating[Any]]
HandPlace = tuple[int, str]
HandView = tuple[str, int, str]  # camera, frame, hand


@dataclass(frozen=True, eq=False)
class _Found:
    """What a run found at some frames of a sequence.

    Attributes:
        joints_mm: Of the last round (21, 3), by frame and hand; NaN where missing.
        keypoints_px: Of detectors (21, 2), by camera, frame and hand; NaN where not seen.
        expected: Cameras, frames and hands where the body says that the picture shows the hand.
    """

    cameras: Mapping[str, Camera]
    video_files: Mapping[str, str]
    joints_mm: Mapping[HandPlace, Floats]
    keypoints_px: Mapping[HandView, Floats]
    expected: frozenset[HandView]

    def start_px(self, camera_id: str, frame: int) -> dict[Hand, Floats]:
        """Return where a person starts from: where the annotation is seen in a picture, else what a detector saw."""
        missing = np.full((NUM_JOINTS, 3), np.nan)
        found: dict[Hand, Floats] = {}
        for hand in HANDS:
            annotated = self.cameras[camera_id].project(self.joints_mm.get((frame, hand), missing))
            detected = self.keypoints_px.get((camera_id, frame, hand), missing[:, :2])
            found[hand] = np.where(np.isfinite(annotated).all(axis=1, keepdims=True), annotated, detected)
        return found


def write_suspects(config: RunConfig, console: Console) -> int:
    """Write a task for each sequence that ``seq`` names in a run; return the exit code.

    Raises:
        UserError: There is no such run or sequence, nowhere to write, or none of the videos is where it was.
    """
    if config.corrections is None:
        raise UserError("corrections=null says that none are used; name their folder: corrections=PATH")
    run = open_run(config, config.run)
    there = [name for name in run.sequences if any(run.folder.glob(f"round_0/joints/{name}.*"))]
    for sequence_id in chosen_sequences(config.seq, there, run.name, "joints"):
        for sentence in _write_one(run, sequence_id, config, config.corrections.absolute()):
            say(console, sentence)
    return 0


def _write_one(run: FinishedRun, sequence_id: str, config: RunConfig, corrections: Path) -> Iterator[str]:
    """Write a sequence's task, and yield what to tell the user."""
    wanted, tables = config.suspects, SequenceTables(run.folder, sequence_id)
    nodes = [node.name for node in round_nodes(run.folder)]
    joints = tables.read(nodes[-1], "joints", JOINTS)
    rounds = [tables.read(node, "rounds", ROUNDS) for node in nodes[1:]]
    residuals = tables.read("round_0", "residuals", RESIDUALS)
    suspects = find_suspects(joints, rounds, residuals, wanted.limits())
    chosen = choose_suspects(suspects, wanted.max_instants, wanted.min_gap_frames)
    yield f"{sequence_id}, {nodes[-1]} of run {run.name}: {len(suspects)} of {joints.num_rows} hands are suspicious"
    if not chosen:
        return
    found = _found(tables, joints, {suspect.frame for suspect in chosen}, config)
    pictures = task_pictures(sequence_id, list(_places(found, chosen, wanted.max_views)))
    if not pictures:
        yield "no view shows any of them"
        return
    readers, lost = _opened({picture.camera_id: found.video_files[picture.camera_id] for picture in pictures})
    yield from (f"  {camera_id} is left out: {error}" for camera_id, error in lost.items())
    if not readers:
        raise UserError(
            f"{sequence_id}: no video of the views to look at can be read; put them back where the run had them, "
            f"the first: {next(iter(lost.values()))}"
        )
    folder = task_folder(corrections, pictures[0].file_name)
    written = list(_written(folder / IMAGES, readers, pictures, wanted.jpeg_quality))
    rows = [(s.frame, s.hand, f"{s.severity:.2f}", "; ".join(s.reasons)) for s in chosen]
    write_task(folder, written, rows)
    yield from (f"  frame {frame}, {hand} hand: {reasons}" for frame, hand, _, reasons in rows[:_SHOWN])
    yield f"task: {len(chosen)} hands in {len(written)} pictures, worst first in suspects.csv: {folder}"


def _found(tables: SequenceTables, joints: pa.Table, frames: set[int], config: RunConfig) -> _Found:
    is_wanted = pc.field("frame").isin(sorted(frames))
    views, joints = tables.read("ingest", "views", VIEWS), joints.filter(is_wanted)
    keypoints = tables.read("detect_keypoints", "keypoints", KEYPOINTS).filter(is_wanted & pc.field("valid"))
    boxes = tables.read("detect_hands", "hand_boxes", HAND_BOXES).filter(is_wanted & pc.field("valid"))
    min_confidence = float(config.stages["triangulate"].model_dump()["min_confidence"])
    places = zip(joints["frame"].to_pylist(), joints["hand"].to_pylist(), strict=True)
    return _Found(
        cameras=valid_cameras(views),
        video_files=dict(zip(views["camera_id"].to_pylist(), views["video_file"].to_pylist(), strict=True)),
        joints_mm=dict(zip(places, joints_or_nan(joints), strict=True)),
        keypoints_px={
            (row["camera_id"], row["frame"], row["hand"]): _seen_px(row, min_confidence)
            for row in keypoints.to_pylist()
        },
        expected=frozenset(zip(*(boxes[name].to_pylist() for name in ("camera_id", "frame", "hand")), strict=True)),
    )


def _seen_px(row: Mapping[str, Any], min_confidence: float) -> Floats:
    is_seen = np.asarray(row["confidence"]) >= min_confidence
    return np.where(is_seen[:, None], np.reshape(row["keypoints_px"], (NUM_JOINTS, 2)), np.nan)


def _places(
    found: _Found, chosen: Sequence[Suspect], max_views: int
) -> Iterator[tuple[str, int, tuple[int, int], Mapping[Hand, Floats]]]:
    """Yield the pictures to look at: of each frame the views that show most of its suspicious hands, the largest.

    Where nothing was found, those that should show them: a person may see what detectors do not.
    """
    hands_of: dict[int, list[str]] = defaultdict(list)
    for suspect in chosen:
        hands_of[suspect.frame].append(suspect.hand)
    for frame, hands in sorted(hands_of.items()):
        starts = {camera_id: found.start_px(camera_id, frame) for camera_id in found.cameras}
        sizes = {
            name: (*_size(camera, starts[name], hands), sum((name, frame, hand) in found.expected for hand in hands))
            for name, camera in found.cameras.items()
        }
        for name in sorted(sizes, key=lambda name: sizes[name], reverse=True)[:max_views]:
            camera = found.cameras[name]
            yield name, frame, (camera.width_px, camera.height_px), starts[name]


def _size(camera: Camera, start: Mapping[Hand, Floats], hands: Sequence[str]) -> tuple[int, float]:
    """Return how many joints of some hands a picture shows, and how large they are in it."""
    inside = [px[camera.contains(px)] for hand, px in start.items() if hand in hands]
    sides = [float(np.ptp(px, axis=0).max()) for px in inside if len(px)]
    return sum(map(len, inside)), sum(sides)


def _opened(video_files: Mapping[str, str]) -> tuple[dict[str, VideoReader], dict[str, VideoError]]:
    """Return the videos of cameras, and of those whose video cannot be opened the reason: it may have been moved."""
    readers: dict[str, VideoReader] = {}
    lost: dict[str, VideoError] = {}
    for camera_id, path in video_files.items():
        try:
            readers[camera_id] = VideoReader(path)
        except VideoError as error:
            lost[camera_id] = error
    return readers, lost


def _written(
    folder: Path, readers: Mapping[str, VideoReader], pictures: Sequence[TaskPicture], quality: int
) -> Iterator[TaskPicture]:
    """Write pictures as the videos have them; yield those that could be read."""
    folder.mkdir(parents=True, exist_ok=True)
    for picture in pictures:
        if picture.camera_id not in readers:
            continue
        try:
            ((_, image),) = readers[picture.camera_id].frames(picture.frame, 1)
        except VideoError:  # detectors found nothing there either; the others are worth looking at
            continue
        (folder / picture.file_name).write_bytes(encode_jpeg(image, quality))
        yield picture
