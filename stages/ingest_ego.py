"""Look at a recording's headset: the lens and the video of each of its cameras, and where they are at every frame.

Lenses come from the recording's calibration, poses from an AssemblyHands `ego_calib` file, whose keys count at 60 Hz.
A camera that cannot be used and a frame without pose get their rows with the reason; the others go on.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, EgoCalibration, read_ego_calibration
from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.camera_rows import camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import EGO_FRAMES, SOURCES, VIEWS
from assemblyhands_core.data.names import ego_calibration_name, ego_serial
from assemblyhands_core.data.rigs import read_calibration
from assemblyhands_core.data.video import VideoError, VideoInfo, probe
from assemblyhands_core.geometry.cameras import Camera
from stages._contract import Context, Stage, StageConfig, Tables

_RATE_TOLERANCE = 0.01

Row = Mapping[str, Any]


def run(config: StageConfig, inputs: Tables, context: Context) -> Tables:
    """Audit the headset of one sequence.

    Raises:
        ValueError: The headset's file of poses lacks this sequence.
    """
    sources = inputs["sources"].to_pylist()
    ego = _poses(_only(sources, "ego_calibration", context), context)
    lenses = read_calibration(_only(sources, "calibration", context), "mm")
    videos = {ego_serial(row["name"]): row for row in sources if row["role"] == "ego_video"}
    views = [_view(name, lenses, videos.get(ego_serial(name)), context) for name in ego.camera_ids]
    frames = [row for view in views if view["valid"] for row in _frames(view, ego)]
    return {"views": VIEWS.from_rows(views), "frames": EGO_FRAMES.from_rows(frames)}


def _only(sources: Sequence[Row], role: str, context: Context) -> Path:
    files = [row["source_file"] for row in sources if row["role"] == role]
    if len(files) != 1:
        raise ValueError(f"sequence {context.sequence_id} has {len(files)} files of role {role}, it must have 1")
    return Path(files[0])


def _poses(path: Path, context: Context) -> EgoCalibration:
    recordings = read_ego_calibration(path)
    if context.sequence_id not in recordings:
        raise ValueError(f"{path} has no recording {context.sequence_id}: give the file of its split")
    return recordings[context.sequence_id]


def _view(camera_id: str, lenses: Mapping[str, Camera], source: Row | None, context: Context) -> dict[str, Any]:
    """Return a camera's row: its lens, posed in the headset's frame, and its video."""
    camera = lenses.get(ego_calibration_name(camera_id))
    info, reason, note = _judged(camera, source)
    row = {
        "sequence_id": context.sequence_id,
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
    if abs(_keys_per_frame(float(info.rate_hz)) * float(info.rate_hz) - KEY_RATE_HZ) > _RATE_TOLERANCE * KEY_RATE_HZ:
        return info, "different_rate", f"{float(info.rate_hz):.2f} Hz is no whole part of the poses' {KEY_RATE_HZ} Hz"
    return info, "", ""


def _keys_per_frame(rate_hz: float) -> int:
    return max(1, round(KEY_RATE_HZ / rate_hz))


def _link(camera_id: str, source: Row, context: Context) -> str:
    """Link to the camera's video from the result; return the link's name."""
    video = Path(source["source_file"]).absolute()
    name = blob_name(camera_id, video.suffix)
    (context.blob_dir / name).symlink_to(video)
    return name


def _frames(view: Row, ego: EgoCalibration) -> Iterator[dict[str, Any]]:
    """Yield a row for each frame of a camera's video."""
    step, unknown = _keys_per_frame(view["rate_hz"]), np.full(16, np.nan)
    for frame in range(view["num_frames"]):
        pose = ego.poses_at(step * frame).get(view["camera_id"])
        yield {
            "sequence_id": view["sequence_id"],
            "frame": frame,
            "camera_id": view["camera_id"],
            "T_camera_from_world": unknown if pose is None else pose.ravel(),
            "image_file": "",
            "valid": pose is not None,
            "reason": "" if pose is not None else "no_pose",
        }


STAGE = Stage(
    name="ingest_ego",
    version=1,
    config=StageConfig,
    inputs={"sources": SOURCES},
    outputs={"views": VIEWS, "frames": EGO_FRAMES},
    run=run,
    shard="sequence",
)
