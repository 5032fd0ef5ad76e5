"""Look at a recording's headset: its cameras, where they are at every frame, and what people annotated in its pictures.

It comes with raw videos, whose lenses stand in the recording's calibration, or with the rectified pictures of the
AssemblyHands release. Poses are those of an AssemblyHands `ego_calib` file. A camera that cannot be used and a frame
without pose get their rows with the reason; the others go on.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, EgoCalibration, JointAnnotations, read_ego_calibration
from assemblyhands_core.data.assemblyhands_images import image_root, read_ego_images
from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.ego_sources import RELEASE_RATE_HZ, ReleasePictures, pose_rows
from assemblyhands_core.data.ego_tables import EGO_BOXES, EGO_FRAMES
from assemblyhands_core.data.fine_grained import Segment, read_fine_grained
from assemblyhands_core.data.label_rows import as_joint_rows, first_key_of, keys_per_frame, label_rows, read_recording
from assemblyhands_core.data.names import ego_calibration_name, ego_serial
from assemblyhands_core.data.rigs import read_calibration
from assemblyhands_core.data.video import VideoError, VideoInfo, probe
from assemblyhands_core.geometry.cameras import Camera
from stages._contract import Context, Stage, StageConfig, Tables

Row = Mapping[str, Any]


class IngestEgoConfig(StageConfig):
    """Parameters of cutting, and how keys count."""

    chunk_frames: int = Field(ge=1, le=100_000)
    first_key: int | None = Field(ge=0)


def run(config: IngestEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Audit the headset of one sequence.

    Raises:
        ValueError: A file of the headset or of its labels lacks this sequence, or is not as it should be.
    """
    sources = inputs["sources"].to_pylist()
    ego = _poses(_only(sources, "ego_calibration", context), context)
    is_release = any(row["role"] == "ego_images" for row in sources)
    found = (_from_pictures if is_release else _from_videos)(config, sources, ego, context)
    name = {"sequence_id": context.sequence_id}
    views, frames, boxes = ([name | row for row in rows] for rows in (found["views"], found["frames"], found["boxes"]))
    num_frames = max((row["num_frames"] for row in views), default=0)
    return {
        "views": VIEWS.from_rows(views),
        "chunks": CHUNKS.from_rows([name | row for row in _chunks(config, num_frames)]),
        "frames": EGO_FRAMES.from_rows(frames),
        "boxes": EGO_BOXES.from_rows(boxes),
        "joints": JOINTS.from_rows(found["joints"]),
    }


def _only(sources: Sequence[Row], role: str, context: Context) -> Path:
    files = [row["source_file"] for row in sources if row["role"] == role]
    if len(files) != 1:
        raise ValueError(f"sequence {context.sequence_id} has {len(files)} files of role {role}, it must have 1")
    return Path(files[0])


def _poses(path: Path, context: Context) -> EgoCalibration:
    recordings = read_ego_calibration(path, context.sequence_id)
    if context.sequence_id not in recordings:
        raise ValueError(f"{path} has no recording {context.sequence_id}: give the file of its split")
    return recordings[context.sequence_id]


def _from_pictures(
    config: IngestEgoConfig, sources: Sequence[Row], ego: EgoCalibration, context: Context
) -> dict[str, list[Any]]:
    """Return the rows of a recording of the release, whose frame 0 is the first one annotated."""
    listing = _only(sources, "ego_images", context)
    images = read_ego_images(listing, context.sequence_id)
    if not images:
        raise ValueError(f"{listing} lists no picture of {context.sequence_id}: give the file of its split")
    labels = next((row for row in sources if row["role"] == "labels"), None)
    joints = read_recording(labels, context.sequence_id) if labels else None
    if (first_key := config.first_key) is None:
        first_key = first_key_of(labels, joints) if labels and joints else min(image.frame_60hz for image in images)
    folder = image_root(_only(sources, "ego_image_folder", context))
    segments = _segments(sources, context)
    pictures = ReleasePictures(images, folder, ego, first_key, segments)
    return {
        "views": list(pictures.view_rows()),
        "frames": list(pictures.frame_rows()),
        "boxes": list(pictures.box_rows()),
        "joints": _joint_rows(labels, joints, first_key, RELEASE_RATE_HZ, context),
    }


def _from_videos(
    config: IngestEgoConfig, sources: Sequence[Row], ego: EgoCalibration, context: Context
) -> dict[str, list[Any]]:
    """Return the rows of a recording with raw videos, whose frame 0 has key 0 unless told otherwise."""
    lenses = read_calibration(_only(sources, "calibration", context), "mm")
    videos = {ego_serial(row["name"]): row for row in sources if row["role"] == "ego_video"}
    views = [_view(name, lenses, videos.get(ego_serial(name)), context) for name in ego.camera_ids]
    usable, segments = [view for view in views if view["valid"]], _segments(sources, context)
    labels = next((row for row in sources if row["role"] == "labels"), None)
    joints = read_recording(labels, context.sequence_id) if labels and usable else None
    first_key = config.first_key or 0
    return {
        "views": views,
        "frames": [row for view in usable for row in pose_rows(view, ego, first_key, segments)],
        "boxes": [],
        "joints": _joint_rows(labels, joints, first_key, usable[0]["rate_hz"], context) if usable else [],
    }


def _segments(sources: Sequence[Row], context: Context) -> list[Segment]:
    files = [row["source_file"] for row in sources if row["role"] == "actions"]
    found = [segment for file in files for segment in read_fine_grained(Path(file)).segments]
    return [segment.at_rate(KEY_RATE_HZ) for segment in found if segment.recording == context.sequence_id]


def _joint_rows(
    source: Row | None, joints: JointAnnotations | None, first_key: int, rate_hz: float, context: Context
) -> list[dict[str, Any]]:
    if source is None or joints is None:
        return []
    step = keys_per_frame(rate_hz)
    return as_joint_rows(label_rows(context.sequence_id, joints, first_key, step, source["source_file"]))


def _view(camera_id: str, lenses: Mapping[str, Camera], source: Row | None, context: Context) -> dict[str, Any]:
    """Return a camera's row: its lens, posed in the headset's frame, and its video."""
    camera = lenses.get(ego_calibration_name(camera_id))
    info, reason, note = _judged(camera, source)
    row = {
        "camera_id": camera_id,
        "video_file": _link(camera_id, source, context) if source else "",
        "video_sha256": source["sha256"] if source else "",
        "num_frames": info.num_frames if info else 0,
        "rate_hz": float(info.rate_hz) if info else float("nan"),
        "image_fit": "same" if not reason else "",
        "note": note,
        "valid": not reason,
        "reason": reason,
    }
    return row | (camera_to_row(camera) if camera is not None and not reason else missing_camera_row())


def _judged(camera: Camera | None, source: Row | None) -> tuple[VideoInfo | None, str, str]:
    """Return what is known of a camera's video, and why it cannot be used, with a sentence."""
    if camera is None:
        return None, "no_calibration", "the calibration lacks its lens"
    if source is None:
        return None, "missing_video", "no video is named after it"
    try:
        info = probe(source["source_file"])
    except VideoError as error:
        return None, "unreadable_video", str(error)
    if (info.width_px, info.height_px) != (camera.width_px, camera.height_px):
        sizes = f"{info.width_px}×{info.height_px} px, its calibration {camera.width_px}×{camera.height_px} px"
        return info, "image_size_mismatch", f"its video has {sizes}"
    try:
        keys_per_frame(float(info.rate_hz))
    except ValueError as error:
        return info, "different_rate", str(error)
    return info, "", ""


def _link(camera_id: str, source: Row, context: Context) -> str:
    """Link to the camera's video from the result; return the link's name."""
    video = Path(source["source_file"]).absolute()
    name = blob_name(camera_id, video.suffix)
    (context.blob_dir / name).symlink_to(video)
    return name


def _chunks(config: IngestEgoConfig, num_frames: int) -> Iterator[dict[str, Any]]:
    for chunk, first in enumerate(range(0, max(num_frames, 1), config.chunk_frames)):  # one, if there is nothing
        yield {"chunk": chunk, "first_frame": first, "num_frames": min(config.chunk_frames, num_frames - first)}


STAGE = Stage(
    name="ingest_ego",
    version=2,
    config=IngestEgoConfig,
    inputs={"sources": SOURCES},
    outputs={"views": VIEWS, "chunks": CHUNKS, "frames": EGO_FRAMES, "boxes": EGO_BOXES, "joints": JOINTS},
    run=run,
    shard="sequence",
)
