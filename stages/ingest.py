"""Look at a recording before hours are spent on it: which video shows which camera, and which views can be used.

Reads the calibration, matches the videos to its cameras by name, counts the frames that are really there and finds the
camera of each video's own pixels. Every camera and every video gets a row: one that cannot be used says why, and the
run goes on with the others. The sequence is as long as the median of its views; a view that ends earlier is used for
the frames that it has, and each frame that it lacks is counted where it is missed.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from pydantic import Field

from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, SOURCES, VIEWS
from assemblyhands_core.data.crop_images import ImageRGB
from assemblyhands_core.data.image_fit import FitChoice, fit_image
from assemblyhands_core.data.rigs import LengthUnit, match_videos, read_calibration
from assemblyhands_core.data.video import VideoError, VideoInfo, VideoReader, probe
from assemblyhands_core.geometry.cameras import Camera
from stages._contract import Context, Stage, StageConfig, Tables

_MIN_VIEWS = 2
_SAMPLED_PLACES = (0.1, 0.5, 0.9)  # of a video's length

Row = Mapping[str, Any]


class IngestConfig(StageConfig):
    """Parameters of ingestion."""

    chunk_frames: int = Field(ge=1, le=100_000)
    min_chunks: int = Field(ge=1)
    max_frames: int | None = Field(ge=1)
    image_fit: FitChoice
    length_unit: LengthUnit
    max_rate_difference: float = Field(ge=0, lt=1)


@dataclass(frozen=True)
class _View:
    """What is known so far of a camera, a video, or both; ``reason`` is empty while nothing speaks against its use."""

    camera_id: str
    camera: Camera | None = None
    source: Row | None = None
    info: VideoInfo | None = None
    num_frames: int = 0
    image_fit: str = ""
    reason: str = ""
    notes: tuple[str, ...] = ()

    def refused(self, reason: str, note: str) -> "_View":
        return replace(self, reason=reason, notes=(*self.notes, note))

    def noted(self, *notes: str) -> "_View":
        return replace(self, notes=(*self.notes, *notes))


def run(config: IngestConfig, inputs: Tables, context: Context) -> Tables:
    """Audit the files of one sequence and cut it into chunks.

    Raises:
        ValueError: the calibration is wrong, or fewer than two views can be used.
    """
    sources = inputs["sources"].to_pylist()
    cameras = read_calibration(_calibration_file(sources, context), config.length_unit)
    matched = _match([row for row in sources if row["role"] == "video"], cameras)
    with ThreadPoolExecutor(max(1, context.num_threads)) as pool:
        views = list(pool.map(partial(_inspect, config), matched))
    views = _check_rates(config, views)
    _check_enough(views, context)
    num_frames = _sequence_frames(config, views)
    rows = [_row(_count_frames(view, num_frames), context) for view in views]
    return {"views": VIEWS.from_rows(rows), "chunks": CHUNKS.from_rows(list(_chunks(config, num_frames, context)))}


def _calibration_file(sources: Sequence[Row], context: Context) -> Path:
    files = [row["source_file"] for row in sources if row["role"] == "calibration"]
    if len(files) != 1:
        raise ValueError(f"sequence {context.sequence_id} has {len(files)} calibration files, it must have 1")
    return Path(files[0])


def _match(videos: Sequence[Row], cameras: Mapping[str, Camera]) -> list[_View]:
    """Return the cameras in the order of the calibration, then the videos that show none of them."""
    by_path = {Path(row["source_file"]): row for row in videos}
    match = match_videos(by_path, cameras)
    views = [_View(name, camera) for name, camera in cameras.items()]
    known = [
        replace(view, source=by_path[match.video_by_camera[view.camera_id]])
        if view.camera_id in match.video_by_camera
        else view.refused("missing_video", f"no video is named after camera {view.camera_id}")
        for view in views
    ]
    # A video that is not the camera's of this name goes by its whole file name, which is no camera's.
    return known + [
        _View(path.name if path.stem in cameras else path.stem, source=by_path[path]).refused("no_calibration", problem)
        for path, problem in match.problems.items()
    ]


def _inspect(config: IngestConfig, view: _View) -> _View:
    """Probe a matched view's video and find the camera of its pixels."""
    camera, source = view.camera, view.source
    if camera is None or source is None:
        return view
    try:
        info = probe(source["source_file"])
        picture = _brightest(Path(source["source_file"]), info)
    except VideoError as error:
        return view.refused("unreadable_video", str(error))
    view = replace(view, info=info, num_frames=info.num_frames)
    try:
        fit = fit_image(camera, picture, config.image_fit)
    except ValueError as error:
        return view.refused("image_size_mismatch", str(error))
    if fit.camera is None:
        return view.refused(fit.reason or fit.kind, fit.sentence)
    notes = [fit.sentence] if fit.is_suspect or fit.kind != "same" else []
    return replace(view, camera=fit.camera, image_fit=fit.kind).noted(*notes)


def _brightest(path: Path, info: VideoInfo) -> ImageRGB:
    """Return the brightest value of each pixel over a few frames: what stays black shows no picture."""
    reader = VideoReader(path, threads=1)
    frames = {round(place * (info.num_frames - 1)) for place in _SAMPLED_PLACES}
    found = [picture for first in sorted(frames) for _, picture in reader.frames(first, 1, on_missing="skip")]
    return np.asarray(np.maximum.reduce(found or [picture for _, picture in reader.frames(0, 1)]))


def _check_rates(config: IngestConfig, views: Sequence[_View]) -> list[_View]:
    """Refuse views whose frame rate is not the one that most views share, the first one's in a tie."""
    rates_hz = [float(view.info.rate_hz) for view in views if view.info and not view.reason]

    def agree(a: float, b: float) -> bool:
        return abs(a - b) <= config.max_rate_difference * b

    common_hz = max(rates_hz, key=lambda rate: sum(agree(other, rate) for other in rates_hz), default=0.0)
    return [
        view
        if view.reason or view.info is None or agree(float(view.info.rate_hz), common_hz)
        else view.refused("different_rate", _rate_note(float(view.info.rate_hz), common_hz))
        for view in views
    ]


def _rate_note(rate_hz: float, common_hz: float) -> str:
    return f"runs at {rate_hz:.3f} Hz, the other views at {common_hz:.3f} Hz; convert it to their frames"


def _check_enough(views: Sequence[_View], context: Context) -> None:
    bad = [f"{view.camera_id} ({view.reason}: {' '.join(view.notes)})" for view in views if view.reason]
    if len(views) - len(bad) < _MIN_VIEWS:
        raise ValueError(
            f"sequence {context.sequence_id} has {len(views) - len(bad)} usable views, 3D needs {_MIN_VIEWS}; "
            f"not usable: {'; '.join(bad)}"
        )


def _sequence_frames(config: IngestConfig, views: Sequence[_View]) -> int:
    middle = int(median([view.num_frames for view in views if not view.reason]))
    return min(middle, config.max_frames or middle)


def _count_frames(view: _View, num_frames: int) -> _View:
    """Note what is odd about a view's frames, and leave those beyond the sequence's end alone."""
    if view.info is None:
        return view
    notes = []
    if view.info.is_truncated:
        notes.append(f"the file breaks off after {view.num_frames} frames")
    if view.num_frames < num_frames:
        notes.append(f"lacks the frames {view.num_frames} to {num_frames - 1} of the sequence")
    if not view.info.is_constant_rate:
        notes.append("its frames are not evenly spaced in time, they are taken by number")
    return replace(view, num_frames=min(view.num_frames, num_frames)).noted(*notes)


def _row(view: _View, context: Context) -> dict[str, Any]:
    camera = missing_camera_row() if view.reason or view.camera is None else camera_to_row(view.camera)
    return {
        "sequence_id": context.sequence_id,
        "camera_id": view.camera_id,
        "video_file": _link(view, context),
        "video_sha256": view.source["sha256"] if view.source else "",
        "num_frames": view.num_frames,
        "rate_hz": float(view.info.rate_hz) if view.info else float("nan"),
        "image_fit": view.image_fit,
        "note": "; ".join(note.rstrip(".") for note in view.notes),
        **camera,
        "valid": not view.reason,
        "reason": view.reason,
    }


def _link(view: _View, context: Context) -> str:
    """Link to the view's video from the result; return the link's name."""
    if view.source is None:
        return ""
    video = Path(view.source["source_file"]).absolute()
    name = blob_name(view.camera_id, video.suffix)
    (context.blob_dir / name).symlink_to(video)
    return name


def _chunks(config: IngestConfig, num_frames: int, context: Context) -> Iterator[dict[str, Any]]:
    length = min(config.chunk_frames, -(-num_frames // config.min_chunks))
    for chunk, first in enumerate(range(0, num_frames, length)):
        yield {
            "sequence_id": context.sequence_id,
            "chunk": chunk,
            "first_frame": first,
            "num_frames": min(length, num_frames - first),
        }


STAGE = Stage(
    name="ingest",
    version=1,
    config=IngestConfig,
    inputs={"sources": SOURCES},
    outputs={"views": VIEWS, "chunks": CHUNKS},
    run=run,
    shard="sequence",
)
