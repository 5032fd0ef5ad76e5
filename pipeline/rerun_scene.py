"""What a run knows of a sequence, put into a file for rerun: cameras, pictures, keypoints, joints of all methods."""

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS, VIEWS
from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.viz.first_look import look_at_hands, up_axis
from assemblyhands_core.viz.joint_layers import TRUTH, JointLayer, joint_layer, layer_color, true_layer
from assemblyhands_core.viz.rerun_file import WORLD, RerunFile, Visibility, open_rerun_file
from pipeline.config import ViewConfig
from pipeline.rerun_cameras import FixedCamera, ShownCamera, shown_cameras
from pipeline.sequence_tables import SequenceTables

_STARTED_FROM_TRUTH: Final = ("true_start", "upper_bound")  # no estimates of what is in the pictures
_ROUND: Final = "round_"

Frames = npt.NDArray[np.int64]


def write_scene(
    path: Path, tables: SequenceTables, config: ViewConfig, min_confidence: float, truth: Path | None
) -> str:
    """Write a sequence's file; return a sentence about what is in it.

    Args:
        path: The file.
        tables: What the run has.
        config: How much of it is written.
        min_confidence: Keypoints below were not used by triangulation.
        truth: Folder of the ground truth, if there is one.
    """
    num_frames, rate_hz = _extent(tables)
    end = min(num_frames, config.first_frame + config.num_frames)
    frames = np.arange(config.first_frame, end, config.step, dtype=np.int64)
    cameras = shown_cameras(tables, config.first_frame, end, config.max_side_px, min_confidence)
    layers = _layers(tables, frames, truth)
    fixed = [camera.raw for camera in cameras if isinstance(camera, FixedCamera)]
    up = up_axis(fixed)
    with open_rerun_file(path, f"{tables.run.name}/{tables.sequence_id}", rate_hz) as file:
        file.world(up)
        for layer in layers:
            _add_layer(file, frames, layer)
        _add_curves(file, frames, layers)
        for camera in cameras:
            camera.add_to(file, frames)
        for camera in cameras if config.pictures and len(frames) else ():  # what is large comes last
            _add_pictures(file, frames, camera, config.jpeg_quality)
        file.layout(
            [camera.path for camera in cameras], _shown(layers), look_at_hands(_first_joints(layers), fixed, up)
        )
    return _sentence(tables.sequence_id, frames, num_frames, cameras, layers, config)


def _extent(tables: SequenceTables) -> tuple[int, float]:
    """Return the number of frames of the longest video, and their rate."""
    for node in ("ingest", "ingest_ego"):
        views = tables.read(node, "views", VIEWS)
        views = views.filter(views["valid"])
        if views.num_rows:
            return max(views["num_frames"].to_pylist()), float(np.median(to_numpy(views["rate_hz"])))
    return 0, float("nan")


def _layers(tables: SequenceTables, frames: Frames, truth: Path | None) -> list[JointLayer]:
    """Return what every node of the run says about the hands, rounds first, the truth last."""
    nodes = [node for node in tables.nodes_with("joints") if node not in _STARTED_FROM_TRUTH]
    nodes.sort(key=lambda node: (not node.startswith(_ROUND), node))
    layers = [
        joint_layer(node, tables.read(node, "joints", JOINTS), frames, layer_color(number))
        for number, node in enumerate(nodes)
    ]
    return [*layers, *([true_layer(truth, frames)] if truth is not None else [])]


def _first_joints(layers: list[JointLayer]) -> npt.NDArray[np.float64]:
    """Return all joints (point, 3) of the first frame that has any."""
    if not layers:
        return np.empty((0, 3))
    points = np.concatenate([layer.joints_world_mm for layer in layers], axis=1)
    has_any = np.isfinite(points).any(axis=(1, 2, 3))
    return np.asarray(points[has_any][:1].reshape(-1, 3))


def _shown(layers: list[JointLayer]) -> dict[str, Visibility]:
    """Return what is shown at first: the truth and the last round, curves of all rounds; all if there is no round."""
    rounds = [layer.name for layer in layers if layer.name.startswith(_ROUND)]
    return {
        name: Visibility(not rounds or name in (rounds[-1], TRUTH), not rounds or name in rounds)
        for name in (layer.name for layer in layers)
    }


def _add_layer(file: RerunFile, frames: Frames, layer: JointLayer) -> None:
    for number, hand in enumerate(HANDS):
        what = [WORLD, layer.name, hand], frames, layer.joints_world_mm[:, number], hand, layer.color
        file.joints(*what)
        if layer.name != TRUTH:
            file.side(*what)


def _add_curves(file: RerunFile, frames: Frames, layers: list[JointLayer]) -> None:
    """Add how far each method's joints are off in the views, and from the truth."""
    truth = next((layer for layer in layers if layer.name == TRUTH), None)
    for layer in layers:
        curves = {"reprojection_px": layer.mean_reprojection_px()}
        if truth is not None and layer is not truth:
            curves["error_mm"] = layer.mean_error_mm(truth)
        for kind, values in curves.items():
            for number, hand in enumerate(HANDS):
                if np.isfinite(values[:, number]).any():
                    file.plot([kind, layer.name], frames, values[:, number], hand, layer.color)


def _add_pictures(file: RerunFile, frames: Frames, camera: ShownCamera, jpeg_quality: int) -> None:
    missing = set(frames.tolist())
    for frame, picture in camera.pictures(frames):
        file.picture([*camera.path, "picture"], frame, encode_jpeg(camera.rectifier(picture), jpeg_quality))
        missing.discard(frame)
    for frame in sorted(missing):
        file.picture([*camera.path, "picture"], frame, None)


def _sentence(
    sequence_id: str,
    frames: Frames,
    num_frames: int,
    cameras: list[ShownCamera],
    layers: list[JointLayer],
    config: ViewConfig,
) -> str:
    parts = [f"{len(frames)} of {num_frames} frames", f"{len(cameras)} cameras"]
    if config.pictures:
        sizes = {(camera.rectifier.camera.width_px, camera.rectifier.camera.height_px) for camera in cameras}
        parts.append(f"rectified pictures of {', '.join(f'{w}×{h} px' for w, h in sorted(sizes))}")
    parts.append(f"joints of {', '.join(layer.name for layer in layers) or 'nobody'}")
    more = "" if len(frames) == num_frames else " (view.first_frame, view.num_frames and view.step choose frames)"
    return f"{sequence_id}: {'; '.join(parts)}{more}"
