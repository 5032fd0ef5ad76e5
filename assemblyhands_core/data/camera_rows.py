"""Cameras as columns of a table (the shared camera columns of ``data/columns.py``) and back."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import lens_from_coefficients

CAMERA_COLUMNS = ("width_px", "height_px", "lens_model", "intrinsics_px", "lens_coefficients", "T_camera_from_world")


def camera_to_row(camera: Camera) -> dict[str, Any]:
    """Return the camera columns of a row; the camera's name is the row's ``camera_id``."""
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "lens_model": camera.lens.model,
        "intrinsics_px": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
        "lens_coefficients": camera.lens.coefficients(),
        "T_camera_from_world": camera.T_camera_from_world.ravel(),
    }


def missing_camera_row() -> dict[str, Any]:
    """Return the camera columns of a view whose camera is unknown."""
    return {
        "width_px": 0,
        "height_px": 0,
        "lens_model": "",
        "intrinsics_px": np.full(4, np.nan),
        "lens_coefficients": np.full(10, np.nan),
        "T_camera_from_world": np.full(16, np.nan),
    }


def camera_from_row(row: Mapping[str, Any]) -> Camera:
    """Return the camera of a row that has the camera columns and ``camera_id``."""
    fx, fy, cx, cy = row["intrinsics_px"]
    return Camera(
        camera_id=row["camera_id"],
        width_px=row["width_px"],
        height_px=row["height_px"],
        fx_px=fx,
        fy_px=fy,
        cx_px=cx,
        cy_px=cy,
        lens=lens_from_coefficients(row["lens_model"], np.asarray(row["lens_coefficients"])),
        T_camera_from_world=np.asarray(row["T_camera_from_world"], dtype=np.float64).reshape(4, 4),
    )


def valid_cameras(table: pa.Table) -> dict[str, Camera]:
    """Return the cameras of a table's valid rows by name, in the order of the rows."""
    rows = table.filter(table.column("valid")).select(["camera_id", *CAMERA_COLUMNS]).to_pylist()
    return {row["camera_id"]: camera_from_row(row) for row in rows}
