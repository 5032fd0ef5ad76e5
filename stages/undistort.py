"""Take the lens distortion out of every view (paper, supplement, "Processing of exocentric images").

For each view: the pinhole camera at the same place, how much of the field it keeps, and a coarse remap grid from which
any region is rectified while it is cropped. Full frames are remapped only where rectified videos are asked for.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from assemblyhands_core.data.blob_names import blob_name
from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import RECTIFIED_VIEWS, VIEWS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.video import VideoReader, VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import kept_field_fraction, rectified, valid_mask, valid_region
from assemblyhands_core.geometry.distortion import OVFishEye62
from assemblyhands_core.geometry.regions import RemapGrid, remap
from stages._contract import Context, Stage, StageConfig, Tables

_PROBE_DEPTH_MM = 1000.0  # any will do: a lens maps rays


class UndistortConfig(StageConfig):
    """Parameters of rectification."""

    focal_scale_perspective: float = Field(gt=0, le=4)
    focal_scale_fisheye: float = Field(gt=0, le=4)
    grid_step_px: Literal[1, 2, 4, 8, 16, 32]
    lattice_step_px: int = Field(ge=1)
    max_residual_px: float = Field(gt=0)
    materialize: bool
    video_crf: int = Field(ge=0, le=51)


def run(config: UndistortConfig, inputs: Tables, context: Context) -> Tables:
    """Rectify the views of one sequence; views that cannot be used keep their reason."""
    rows = [_name(view) | _rectify(config, view, context) for view in inputs["views"].to_pylist()]
    return {"rectified_views": RECTIFIED_VIEWS.from_rows(rows)}


def _name(view: Mapping[str, Any]) -> dict[str, Any]:
    return {key: view[key] for key in VIEWS.key}


def _rectify(config: UndistortConfig, view: Mapping[str, Any], context: Context) -> dict[str, Any]:
    if not view["valid"]:
        return _hole(view["reason"])
    source = camera_from_row(view)
    is_fisheye = isinstance(source.lens, OVFishEye62)
    target = rectified(source, config.focal_scale_fisheye if is_fisheye else config.focal_scale_perspective)
    mask = valid_mask(source, target)
    if not mask.any():
        return _hole("empty_view")
    grid = RemapGrid.build(source, target, config.grid_step_px, config.max_residual_px)
    residuals = {
        "round_trip_residual_px": round_trip_residual_px(source, config.lattice_step_px),
        "grid_residual_px": grid.residual_px(source, target),
    }
    if not max(residuals.values()) <= config.max_residual_px:
        return _hole("high_residual") | residuals
    return {
        **camera_to_row(target),
        "kept_fraction": kept_field_fraction(source, target),
        "valid_region_px": valid_region(mask),
        **residuals,
        "grid_step_px": int(grid.step_px),
        "grid": grid.to_bytes(),
        **(_materialize(config, view, target, grid, context) if config.materialize else _NO_VIDEO),
        "valid": True,
        "reason": "",
    }


_NO_VIDEO = {"rectified_file": "", "rectified_sha256": ""}


def _hole(reason: str) -> dict[str, Any]:
    return {
        **missing_camera_row(),
        "kept_fraction": np.nan,
        "valid_region_px": np.full(4, np.nan),
        "round_trip_residual_px": np.nan,
        "grid_residual_px": np.nan,
        "grid_step_px": 0,
        "grid": b"",
        **_NO_VIDEO,
        "valid": False,
        "reason": reason,
    }


def round_trip_residual_px(camera: Camera, step_px: int) -> float:
    """Return the largest distance between a pixel and the projection of its ray, over a lattice that ends at the edges.

    Pixels outside the valid field of the lens have no ray and do not count; NaN if no pixel has one.
    """
    sides = (camera.width_px, camera.height_px)
    x, y = (np.linspace(0.0, side - 1.0, 1 + max(1, (side - 1) // step_px)) for side in sides)
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays = camera.unproject(pixels)
    has_ray = np.isfinite(rays).all(axis=-1)
    if not has_ray.any():
        return float("nan")
    again = camera.project(camera.center_world_mm + _PROBE_DEPTH_MM * rays[has_ray])
    return float(np.linalg.norm(again - pixels[has_ray], axis=-1).max())


def _materialize(
    config: UndistortConfig, view: Mapping[str, Any], target: Camera, grid: RemapGrid, context: Context
) -> dict[str, Any]:
    path = context.blob_dir / blob_name(view["camera_id"], ".mp4")
    _write_rectified(view, path, target, grid, config.video_crf, context.num_threads)
    return {"rectified_file": path.name, "rectified_sha256": digest_file(path)}


def _write_rectified(
    view: Mapping[str, Any], path: Path, target: Camera, grid: RemapGrid, crf: int, num_threads: int
) -> None:
    """Write the rectified video; frames that cannot be decoded are black, so that frame numbers stay what they are."""
    maps = grid.window(target)
    black = np.zeros((target.height_px, target.width_px, 3), dtype=np.uint8)
    pictures = VideoReader(view["video_file"], threads=num_threads).frames(0, view["num_frames"], on_missing="skip")
    with VideoWriter(path, target.width_px, target.height_px, view["rate_hz"], crf) as video:
        for frame, picture in pictures:
            while video.num_frames < frame:
                video.write(black)
            video.write(remap(picture, *maps))
        while video.num_frames < view["num_frames"]:
            video.write(black)


STAGE = Stage(
    name="undistort",
    version=1,
    config=UndistortConfig,
    inputs={"views": VIEWS},
    outputs={"rectified_views": RECTIFIED_VIEWS},
    run=run,
    shard="sequence",
)
