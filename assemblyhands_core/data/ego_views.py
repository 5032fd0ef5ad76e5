"""A headset camera at the frames of a chunk: its pictures, where it is, and the annotated hands before it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB, read_picture
from assemblyhands_core.data.ego_boxes import NO_BOX, EgoBox, EgoRule, ego_box, given_box, no_box
from assemblyhands_core.data.ego_tables import EGO_BOXES, EGO_FRAMES
from assemblyhands_core.data.label_rows import MANUAL
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import RemapGrid
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS

NO_POSE = "no_pose"
_CORRECTED: Final = "corrected"
EGO_INPUTS: Final[Mapping[str, TableSpec]] = {
    "chunks": CHUNKS,
    "views": VIEWS,
    "rectified_views": RECTIFIED_VIEWS,
    "frames": EGO_FRAMES,
    "boxes": EGO_BOXES,
    "joints": JOINTS,
}
"""What `ego_views` and `ego_hands` read of a sequence: the roles of a stage that looks at the headset's pictures."""


@dataclass(frozen=True, eq=False)
class EgoHands:
    """Both hands at one frame, right hand first.

    Attributes:
        joints_world_mm: NaN where not annotated.
        sources: Who annotated each.
    """

    joints_world_mm: Float[np.ndarray, "hand=2 joint=21 3"]
    sources: tuple[str, str]

    @property
    def is_known(self) -> Bool[np.ndarray, "hand=2 joint=21"]:
        """Return which joints are annotated."""
        return np.asarray(np.isfinite(self.joints_world_mm).all(axis=-1))


@dataclass(frozen=True, eq=False)
class EgoView:
    """A camera of the headset.

    Attributes:
        camera_id: Its name.
        video_file: Its raw video; empty where each frame has a picture of its own.
        image_files: frame → that picture.
        rectified: The pinhole camera at the lens's place, in the headset's frame.
        grid: Where its pixels lie in the raw pictures.
        poses: frame → T_camera_from_world.
        verbs: frame → what is being done, if known.
        boxes: frame → hand → left, top, right, bottom that came with the picture, and which joints count in it.
    """

    camera_id: str
    video_file: str
    image_files: Mapping[int, str]
    rectified: Camera
    grid: RemapGrid
    poses: Mapping[int, Float[np.ndarray, "4 4"]]
    verbs: Mapping[int, str]
    boxes: Mapping[int, Mapping[str, tuple[Float[np.ndarray, "4"], Bool[np.ndarray, "21"]]]]

    def camera_at(self, frame: int) -> Camera:
        """Return the rectified camera where it is at a frame that has a pose."""
        return self.rectified.moved(self.poses[frame])

    def hand_boxes(self, frame: int, hands: EgoHands, rule: EgoRule) -> list[EgoBox]:
        """Return the box of each hand at a frame, right hand first, or why there is none.

        A picture of its own has the boxes that came with it, a video's what encloses the projected joints.
        """
        if frame not in self.poses:
            return [no_box(NO_POSE)] * len(HANDS)
        camera = self.camera_at(frame)
        size_px = (camera.width_px, camera.height_px)
        pixels, is_known = camera.project(hands.joints_world_mm), self.known_joints(frame, hands)
        if frame not in self.image_files:
            return [ego_box(px, known, size_px, rule) for px, known in zip(pixels, is_known, strict=True)]
        given = [self.boxes.get(frame, {}).get(hand) for hand in HANDS]
        return [
            no_box(NO_BOX) if box is None else given_box(box[0], px, known, size_px, rule)
            for box, px, known in zip(given, pixels, is_known, strict=True)
        ]

    def known_joints(self, frame: int, hands: EgoHands) -> Bool[np.ndarray, "hand=2 joint=21"]:
        """Return which joints are annotated and, where the picture says so, count in it."""
        given = [self.boxes.get(frame, {}).get(hand) for hand in HANDS]
        counted = [np.ones(NUM_JOINTS, dtype=bool) if box is None else box[1] for box in given]
        return np.asarray(hands.is_known & np.stack(counted))

    def pictures(self, frames: Sequence[int], num_threads: int) -> Iterator[tuple[int, ImageRGB | str]]:
        """Yield raw pictures of ascending frames, or the reason why there is none; what a video lacks is left out."""
        size_px = (self.rectified.width_px, self.rectified.height_px)
        if self.image_files:
            yield from ((frame, read_picture(Path(self.image_files[frame]), size_px)) for frame in frames)
        elif frames:
            count = frames[-1] + 1 - frames[0]
            yield from VideoReader(self.video_file, threads=num_threads).frames(frames[0], count, on_missing="skip")


def ego_views(tables: Mapping[str, pa.Table]) -> Iterator[EgoView]:
    """Yield the usable cameras of a chunk.

    Args:
        tables: `views`, `rectified_views`, `frames`, `boxes` of the sequence, and `chunks`, the one that counts.
    """
    frames, boxes = (of_chunk(tables[role], tables["chunks"]) for role in ("frames", "boxes"))
    videos = {row["camera_id"]: row["video_file"] for row in tables["views"].to_pylist()}
    for rectified in tables["rectified_views"].to_pylist():
        if rectified["valid"]:
            yield _view(videos[rectified["camera_id"]], rectified, frames, boxes)


def ego_hands(tables: Mapping[str, pa.Table]) -> dict[int, EgoHands]:
    """Return the hands at each frame of a chunk that has any joints, or pictures with boxes, ascending.

    Args:
        tables: `joints` and `boxes`, and `chunks` with the one row that counts.
    """
    joints, boxes = (of_chunk(tables[role], tables["chunks"]) for role in ("joints", "boxes"))
    found = {frame: (np.full((2, NUM_JOINTS, 3), np.nan), ["", ""]) for frame in boxes["frame"].to_pylist()}
    names = (joints[name].to_pylist() for name in ("frame", "hand"))
    for points, frame, hand, source in zip(joints_or_nan(joints), *names, _sources(joints), strict=True):
        world, sources = found.setdefault(frame, (np.full((2, NUM_JOINTS, 3), np.nan), ["", ""]))
        world[HANDS.index(hand)], sources[HANDS.index(hand)] = points, source
    return {frame: EgoHands(world, (right, left)) for frame, (world, (right, left)) in sorted(found.items())}


def _sources(joints: pa.Table) -> list[str]:
    """Return who annotated each hand: where people corrected what stands on views, it is still automatic."""
    stands_on_views = (to_numpy(joints["num_views"]) > 0).any(axis=1)
    is_ours = stands_on_views & (to_numpy(joints["source"]) == MANUAL)
    return list(np.where(is_ours, _CORRECTED, to_numpy(joints["source"])))


def of_chunk(table: pa.Table, chunks: pa.Table) -> pa.Table:
    """Return the rows at the frames of a chunk, of a table of the whole sequence."""
    (chunk,) = chunks.to_pylist()
    frame = pc.field("frame")
    return table.filter((frame >= chunk["first_frame"]) & (frame < chunk["first_frame"] + chunk["num_frames"]))


def _view(video_file: str, rectified: Mapping[str, Any], frames: pa.Table, boxes: pa.Table) -> EgoView:
    is_own = pc.field("camera_id") == rectified["camera_id"]
    own = frames.filter(is_own & pc.field("valid"))
    numbers, files, verbs = (own[name].to_pylist() for name in ("frame", "image_file", "verb"))
    return EgoView(
        camera_id=rectified["camera_id"],
        video_file=video_file,
        image_files={frame: file for frame, file in zip(numbers, files, strict=True) if file},
        rectified=camera_from_row(rectified),
        grid=RemapGrid.from_bytes(rectified["grid"]),
        poses=dict(zip(numbers, to_numpy(own["T_camera_from_world"]).reshape(-1, 4, 4).astype(float), strict=True)),
        verbs=dict(zip(numbers, verbs, strict=True)),
        boxes=_by_frame(boxes.filter(is_own).to_pylist()),
    )


def _by_frame(rows: Iterable[Mapping[str, Any]]) -> dict[int, dict[str, Any]]:
    given: dict[int, dict[str, Any]] = {}
    for row in rows:
        given.setdefault(row["frame"], {})[row["hand"]] = np.array(row["box_px"]), np.array(row["is_valid"])
    return given
