"""Cut a generous rectified region around each hand out of every view, with the exact camera of the region.

The only stage that reads pixels at full resolution, each once: all later rounds crop from these regions. Lens
distortion is removed while cropping (paper, supplement, "Processing of exocentric images"), the full frame is never
remapped. A region is stored with at most ``size_px`` pixels a side and never with more than the video has: enlarging it
adds bytes, no information, and a network resizes its input anyway.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, CROPS, HAND_BOXES, RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB, encode_jpeg
from assemblyhands_core.data.video import VideoReader
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import RemapGrid, cut_region
from stages._contract import Context, Stage, StageConfig, Tables

Row = dict[str, Any]


class CropHandsConfig(StageConfig):
    """Parameters of cropping."""

    margin: float = Field(ge=1, le=4)
    size_px: int = Field(ge=32, le=2048)
    jpeg_quality: int = Field(ge=1, le=100)


@dataclass(frozen=True, eq=False)
class _View:
    """A view that crops can be cut from: its video, its rectified camera and the map between the two."""

    video_file: str
    num_frames: int
    rectified: Camera
    grid: RemapGrid


def run(config: CropHandsConfig, inputs: Tables, context: Context) -> Tables:
    """Cut the regions of one chunk of frames; one row for each hand box."""
    boxes = _boxes_of_chunk(inputs["hand_boxes"], inputs["chunks"])
    by_camera: dict[str, list[int]] = {}
    for index, box in enumerate(boxes):
        by_camera.setdefault(box["camera_id"], []).append(index)
    rectified = {row["camera_id"]: row for row in inputs["rectified_views"].to_pylist()}
    views = {row["camera_id"]: row for row in inputs["views"].to_pylist()}
    rows: dict[int, Row] = {}
    for camera_id, indices in by_camera.items():
        own = [boxes[index] for index in indices]
        found = _crop_view(config, views[camera_id], rectified[camera_id], own, context.num_threads)
        rows |= zip(indices, found, strict=True)
    return {"crops": CROPS.from_rows([_name(box) | rows[index] for index, box in enumerate(boxes)])}


def _boxes_of_chunk(hand_boxes: pa.Table, chunks: pa.Table) -> list[dict[str, Any]]:
    first, count = (chunks.column(name)[0].as_py() for name in ("first_frame", "num_frames"))
    frame = hand_boxes.column("frame")
    inside = pc.and_(pc.greater_equal(frame, first), pc.less(frame, first + count))
    rows: list[dict[str, Any]] = hand_boxes.filter(inside).to_pylist()
    return rows


def _name(box: Row) -> dict[str, Any]:
    return {key: box[key] for key in HAND_BOXES.key}


def _crop_view(config: CropHandsConfig, view: Row, rectified: Row, boxes: Sequence[Row], num_threads: int) -> list[Row]:
    """Return what became of each box of one view, in their order."""
    if not rectified["valid"]:
        return [_hole(box["reason"] or rectified["reason"]) for box in boxes]
    by_frame: dict[int, list[int]] = {}
    for index, box in enumerate(boxes):
        if box["valid"]:
            by_frame.setdefault(box["frame"], []).append(index)
    cutter = _view(view, rectified)
    rows = [_hole(box["reason"] or "missing_frame") for box in boxes]
    for frame, picture in _pictures(cutter, sorted(by_frame), num_threads):
        for index in by_frame.get(frame, ()):
            rows[index] = _cut(config, cutter, picture, boxes[index])
    return rows


def _view(view: Row, rectified: Row) -> _View:
    grid = RemapGrid.from_bytes(rectified["grid"])
    return _View(view["video_file"], view["num_frames"], camera_from_row(rectified), grid)


def _pictures(view: _View, frames: Sequence[int], num_threads: int) -> Iterator[tuple[int, ImageRGB]]:
    """Decode once, after one seek, what lies between the first and the last frame asked for."""
    count = min(frames[-1] + 1, view.num_frames) - frames[0] if frames else 0
    if count > 0:
        yield from VideoReader(view.video_file, threads=num_threads).frames(frames[0], count, on_missing="skip")


def _cut(config: CropHandsConfig, view: _View, picture: ImageRGB, box: Row) -> Row:
    """Return the camera and the picture of the region around a box."""
    center_px, side_px = box["center_rectified_px"], config.margin * box["side_px"]
    region = cut_region(picture, view.rectified, view.grid, center_px, side_px, config.size_px)
    if region is None:
        return _hole("outside_view")
    image = encode_jpeg(region.image, config.jpeg_quality)
    return {**camera_to_row(region.camera), "image": image, "valid": True, "reason": ""}


def _hole(reason: str) -> Row:
    return {**missing_camera_row(), "image": b"", "valid": False, "reason": reason}


STAGE = Stage(
    name="crop_hands",
    version=1,
    config=CropHandsConfig,
    inputs={"chunks": CHUNKS, "views": VIEWS, "rectified_views": RECTIFIED_VIEWS, "hand_boxes": HAND_BOXES},
    outputs={"crops": CROPS},
    run=run,
    shard="chunk",
)
