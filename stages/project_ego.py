"""Project annotated hands into the headset's cameras and cut them out: the crops that SVEgoNet learns from.

One row for each hand and camera at every frame that has joints: a crop with its exact camera, both hands' joints in
that camera's frame and in pixels, and whether it shows one hand or both; or the reason why there is no crop. Lens
distortion is removed while cropping (paper, supplement, "Processing of egocentric images"). Pictures that come with
boxes, as the release's do, are cropped around those, annotated or not.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, EGO_BOXES, EGO_CROPS, EGO_FRAMES, JOINTS, RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB, encode_jpeg, read_picture
from assemblyhands_core.data.ego_boxes import (
    NO_BOX,
    OUTSIDE_VIEW,
    EgoBox,
    EgoRule,
    ego_box,
    given_box,
    identity_of,
    no_box,
)
from assemblyhands_core.data.rounds import joints_or_nan
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import RemapGrid, cut_region
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS, Hand
from assemblyhands_core.metrics.keypoints import relative_to_wrist
from stages._contract import Context, Stage, StageConfig, Tables

Floats = npt.NDArray[np.floating[Any]]
Row = dict[str, Any]


class ProjectEgoConfig(StageConfig):
    """Parameters of projection."""

    gamma: float = Field(ge=1, le=6)
    size_px: int = Field(ge=32, le=2048)
    jpeg_quality: int = Field(ge=1, le=100)
    min_joints: int = Field(ge=1, le=NUM_JOINTS)
    min_border_px: float
    min_other_share: float = Field(gt=0, le=1)

    def rule(self) -> EgoRule:
        """Return which crops are made."""
        return EgoRule(self.gamma, self.min_joints, self.min_border_px, self.min_other_share)


@dataclass(frozen=True, eq=False)
class _View:
    """A camera of the headset: its pictures, its rectified camera, the map between the two, and where it is when.

    Attributes:
        image_files: frame → a picture of its own; empty where the video has them all.
        verbs: frame → what is being done, if known.
        boxes: frame → hand → the box that came with the picture.
    """

    camera_id: str
    video_file: str
    image_files: Mapping[int, str]
    verbs: Mapping[int, str]
    rectified: Camera
    grid: RemapGrid
    poses: Mapping[int, Floats]
    boxes: Mapping[int, Mapping[str, Floats]]


@dataclass(frozen=True, eq=False)
class _Hands:
    """Both hands at one frame, right hand first; NaN where not annotated."""

    joints_world_mm: Floats  # (2, 21, 3)
    sources: tuple[str, str]

    @property
    def is_known(self) -> npt.NDArray[np.bool_]:
        """Return which joints (2, 21) are annotated."""
        return np.asarray(np.isfinite(self.joints_world_mm).all(axis=-1))


def run(config: ProjectEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Project and crop one chunk of frames."""
    joints, frames, boxes = (_of_chunk(inputs[role], inputs["chunks"]) for role in ("joints", "frames", "boxes"))
    hands = _hands(joints, boxes["frame"].to_pylist())
    videos = {row["camera_id"]: row for row in inputs["views"].to_pylist()}
    rows: list[Row] = []
    for rectified in inputs["rectified_views"].to_pylist():
        if rectified["valid"]:
            view = _view(videos[rectified["camera_id"]], rectified, frames, boxes)
            rows += [{"sequence_id": context.sequence_id, **row} for row in _rows(config, view, hands, context)]
    return {"crops": EGO_CROPS.from_rows(rows)}


def _of_chunk(table: pa.Table, chunks: pa.Table) -> pa.Table:
    """Return the rows at the frames of a chunk, of a table of the whole sequence."""
    (chunk,) = chunks.to_pylist()
    frame = pc.field("frame")
    return table.filter((frame >= chunk["first_frame"]) & (frame < chunk["first_frame"] + chunk["num_frames"]))


def _hands(joints: pa.Table, others: Iterable[int]) -> dict[int, _Hands]:
    """Return the hands of each frame that has any row, and of others, in the order of the frames."""
    found = {frame: (np.full((2, NUM_JOINTS, 3), np.nan), ["", ""]) for frame in others}
    names = (joints[name].to_pylist() for name in ("frame", "hand", "source"))
    for points, frame, hand, source in zip(joints_or_nan(joints), *names, strict=True):
        world, sources = found.setdefault(frame, (np.full((2, NUM_JOINTS, 3), np.nan), ["", ""]))
        world[HANDS.index(hand)], sources[HANDS.index(hand)] = points, source
    return {frame: _Hands(world, (right, left)) for frame, (world, (right, left)) in sorted(found.items())}


def _view(video: Mapping[str, Any], rectified: Mapping[str, Any], frames: pa.Table, boxes: pa.Table) -> _View:
    is_own = pc.field("camera_id") == rectified["camera_id"]
    own = frames.filter(is_own & pc.field("valid"))
    poses = to_numpy(own["T_camera_from_world"]).reshape(-1, 4, 4).astype(np.float64)
    numbers, files = own["frame"].to_pylist(), own["image_file"].to_pylist()
    given: dict[int, dict[str, Floats]] = {}
    for row in boxes.filter(is_own).to_pylist():
        given.setdefault(row["frame"], {})[row["hand"]] = np.array(row["box_px"])
    return _View(
        camera_id=rectified["camera_id"],
        video_file=video["video_file"],
        verbs=dict(zip(numbers, own["verb"].to_pylist(), strict=True)),
        image_files={frame: file for frame, file in zip(numbers, files, strict=True) if file},
        rectified=camera_from_row(rectified),
        grid=RemapGrid.from_bytes(rectified["grid"]),
        poses=dict(zip(numbers, poses, strict=True)),
        boxes=given,
    )


def _rows(config: ProjectEgoConfig, view: _View, hands: Mapping[int, _Hands], context: Context) -> list[Row]:
    """Return what became of both hands at each frame of one camera."""
    boxes = {frame: _boxes(config, view, frame, both) for frame, both in hands.items()}
    rows = {(frame, hand): _hole(box) for frame, both in boxes.items() for hand, box in zip(HANDS, both, strict=True)}
    wanted = [frame for frame, both in boxes.items() if any(not box.reason for box in both)]
    for frame, picture in _pictures(view, wanted, context.num_threads):
        for hand, box in zip(HANDS, boxes.get(frame, ()), strict=False):
            if box.reason:
                continue
            if isinstance(picture, str):
                rows[frame, hand]["reason"] = picture
            else:
                rows[frame, hand] = _crop(config, view, frame, picture, hands[frame], hand, box)
    return [{"frame": frame, "hand": hand, "camera_id": view.camera_id, **row} for (frame, hand), row in rows.items()]


def _boxes(config: ProjectEgoConfig, view: _View, frame: int, hands: _Hands) -> list[EgoBox]:
    if frame not in view.poses:
        return [no_box("no_pose")] * len(HANDS)
    camera = view.rectified.moved(view.poses[frame])
    size_px = (camera.width_px, camera.height_px)
    pixels, rule = camera.project(hands.joints_world_mm), config.rule()
    if frame not in view.boxes:
        return [ego_box(px, known, size_px, rule) for px, known in zip(pixels, hands.is_known, strict=True)]
    given = [view.boxes[frame].get(hand) for hand in HANDS]
    return [
        no_box(NO_BOX) if box is None else given_box(box, px, known, size_px, rule)
        for box, px, known in zip(given, pixels, hands.is_known, strict=True)
    ]


def _pictures(view: _View, frames: Sequence[int], num_threads: int) -> Iterator[tuple[int, ImageRGB | str]]:
    """Yield pictures, or the reason why there is none; frames that a video lacks are left out."""
    size_px = (view.rectified.width_px, view.rectified.height_px)
    if view.image_files:
        yield from ((frame, read_picture(Path(view.image_files[frame]), size_px)) for frame in frames)
    elif frames:
        count = frames[-1] + 1 - frames[0]
        yield from VideoReader(view.video_file, threads=num_threads).frames(frames[0], count, on_missing="skip")


def _crop(
    config: ProjectEgoConfig, view: _View, frame: int, picture: ImageRGB, hands: _Hands, hand: Hand, box: EgoBox
) -> Row:
    """Return a hand's crop with the labels of both hands."""
    rectified = view.rectified.moved(view.poses[frame])
    region = cut_region(picture, rectified, view.grid, box.center_px, box.side_px, config.size_px)
    if region is None:
        return _hole(box) | {"reason": OUTSIDE_VIEW}
    pixels, own = region.camera.project(hands.joints_world_mm), HANDS.index(hand)
    in_camera = np.where(hands.is_known[..., None], region.camera.to_camera(hands.joints_world_mm), np.nan)
    other = rectified.project(hands.joints_world_mm[1 - own])
    return {
        **camera_to_row(region.camera),
        "image": encode_jpeg(region.image, config.jpeg_quality),
        "joints_camera_mm": in_camera.ravel(),
        "joints_wrist_relative_mm": relative_to_wrist(in_camera.reshape(1, NUM_BOTH, 3)).ravel(),
        "joints_px": pixels.ravel(),
        "is_labelled": (hands.is_known & region.camera.contains(pixels)).ravel(),
        "identity": identity_of(box, hand, other, hands.is_known[1 - own], config.rule()),
        "num_in_image": box.num_in_image,
        "border_px": box.border_px,
        "verb": view.verbs.get(frame, ""),
        "source": hands.sources[own],
        "valid": True,
        "reason": "",
    }


def _hole(box: EgoBox) -> Row:
    unknown = np.full(3 * NUM_BOTH, np.nan)
    return {
        **missing_camera_row(),
        "image": b"",
        "joints_camera_mm": unknown,
        "joints_wrist_relative_mm": unknown,
        "joints_px": np.full(2 * NUM_BOTH, np.nan),
        "is_labelled": np.zeros(NUM_BOTH, dtype=bool),
        "identity": "",
        "num_in_image": box.num_in_image,
        "border_px": box.border_px,
        "verb": "",
        "source": "",
        "valid": False,
        "reason": box.reason or "missing_frame",
    }


STAGE = Stage(
    name="project_ego",
    version=2,
    config=ProjectEgoConfig,
    inputs={
        "chunks": CHUNKS,
        "views": VIEWS,
        "rectified_views": RECTIFIED_VIEWS,
        "frames": EGO_FRAMES,
        "boxes": EGO_BOXES,
        "joints": JOINTS,
    },
    outputs={"crops": EGO_CROPS},
    run=run,
    shard="chunk",
)
