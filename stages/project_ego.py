"""Project annotated hands into the headset's cameras and cut them out: the crops that SVEgoNet learns from.

One row for each hand and camera at every frame that has joints: a crop with its exact camera, both hands' joints in
that camera's frame and in pixels, and whether it shows one hand or both; or the reason why there is no crop. Lens
distortion is removed while cropping (paper, supplement, "Processing of egocentric images").
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, EGO_CROPS, EGO_FRAMES, JOINTS, RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB, encode_jpeg
from assemblyhands_core.data.ego_boxes import OUTSIDE_VIEW, EgoBox, EgoRule, ego_box, identity_of, no_box
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
    """A camera of the headset: its video, its rectified camera, the map between the two, and where it is when."""

    camera_id: str
    video_file: str
    rectified: Camera
    grid: RemapGrid
    poses: Mapping[int, Floats]


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
    hands, videos = (
        _hands(_of_chunk(inputs["joints"], inputs["chunks"])),
        {row["camera_id"]: row for row in inputs["views"].to_pylist()},
    )
    rows: list[Row] = []
    for rectified in inputs["rectified_views"].to_pylist():
        if rectified["valid"]:
            view = _view(videos[rectified["camera_id"]], rectified, inputs["frames"])
            rows += [{"sequence_id": context.sequence_id, **row} for row in _rows(config, view, hands, context)]
    return {"crops": EGO_CROPS.from_rows(rows)}


def _of_chunk(joints: pa.Table, chunks: pa.Table) -> pa.Table:
    """Return the joints at the frames of a chunk; those that people annotated are given for the whole sequence."""
    (chunk,) = chunks.to_pylist()
    frame = pc.field("frame")
    return joints.filter((frame >= chunk["first_frame"]) & (frame < chunk["first_frame"] + chunk["num_frames"]))


def _hands(joints: pa.Table) -> dict[int, _Hands]:
    """Return the hands of each frame that has any row, in the order of the frames."""
    found: dict[int, tuple[Floats, list[str]]] = {}
    names = (joints[name].to_pylist() for name in ("frame", "hand", "source"))
    for points, frame, hand, source in zip(joints_or_nan(joints), *names, strict=True):
        world, sources = found.setdefault(frame, (np.full((2, NUM_JOINTS, 3), np.nan), ["", ""]))
        world[HANDS.index(hand)], sources[HANDS.index(hand)] = points, source
    return {frame: _Hands(world, (right, left)) for frame, (world, (right, left)) in sorted(found.items())}


def _view(video: Mapping[str, Any], rectified: Mapping[str, Any], frames: pa.Table) -> _View:
    own = frames.filter(pc.and_(pc.equal(frames["camera_id"], rectified["camera_id"]), frames["valid"]))
    poses = to_numpy(own["T_camera_from_world"]).reshape(-1, 4, 4).astype(np.float64)
    return _View(
        camera_id=rectified["camera_id"],
        video_file=video["video_file"],
        rectified=camera_from_row(rectified),
        grid=RemapGrid.from_bytes(rectified["grid"]),
        poses=dict(zip(own["frame"].to_pylist(), poses, strict=True)),
    )


def _rows(config: ProjectEgoConfig, view: _View, hands: Mapping[int, _Hands], context: Context) -> list[Row]:
    """Return what became of both hands at each frame of one camera."""
    boxes = {frame: _boxes(config, view, frame, both) for frame, both in hands.items()}
    rows = {(frame, hand): _hole(box) for frame, both in boxes.items() for hand, box in zip(HANDS, both, strict=True)}
    wanted = [frame for frame, both in boxes.items() if any(not box.reason for box in both)]
    for frame, picture in _pictures(view, wanted, context.num_threads):
        for hand, box in zip(HANDS, boxes.get(frame, ()), strict=False):
            if not box.reason:
                rows[frame, hand] = _crop(config, view, frame, picture, hands[frame], hand, box)
    return [{"frame": frame, "hand": hand, "camera_id": view.camera_id, **row} for (frame, hand), row in rows.items()]


def _boxes(config: ProjectEgoConfig, view: _View, frame: int, hands: _Hands) -> list[EgoBox]:
    if frame not in view.poses:
        return [no_box("no_pose")] * len(HANDS)
    camera = view.rectified.moved(view.poses[frame])
    size_px = (camera.width_px, camera.height_px)
    pixels = camera.project(hands.joints_world_mm)
    return [ego_box(px, known, size_px, config.rule()) for px, known in zip(pixels, hands.is_known, strict=True)]


def _pictures(view: _View, frames: Sequence[int], num_threads: int) -> Iterator[tuple[int, ImageRGB]]:
    if frames:
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
        "source": "",
        "valid": False,
        "reason": box.reason or "missing_frame",
    }


STAGE = Stage(
    name="project_ego",
    version=1,
    config=ProjectEgoConfig,
    inputs={
        "chunks": CHUNKS,
        "views": VIEWS,
        "rectified_views": RECTIFIED_VIEWS,
        "frames": EGO_FRAMES,
        "joints": JOINTS,
    },
    outputs={"crops": EGO_CROPS},
    run=run,
    shard="chunk",
)
