"""Assembly101's camera calibrations: one JSON list of records per recording, as the toolkit ships them (formats 1).

The reader is `geometry.cameras.load_assembly101_calibration`; here is what writes such a file, with the traps that the
real ones have: the records stand in another order in every file, the names of egocentric cameras lack ``HMC_``, and
their MountingLocation is wrong in nearly all files.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

from assemblyhands_core.data.names import ego_calibration_name, ego_serial
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import COEFFICIENT_NAMES

_MODELS: Final = ("OpenCV", "OVFishEye62")
_SHARE_OF_RIGHT_LOCATIONS: Final = 0.05  # one real file in twenty calls its egocentric cameras egocentric


def write_assembly101_calibration(path: Path, cameras: Iterable[Camera]) -> None:
    """Write the calibration of a recording.

    Args:
        path: File to write; its name decides on the order of the records, so that the same file has the same bytes.
        cameras: Exocentric ones with `T_camera_from_world`, egocentric ones (known by their names) with
            `T_camera_from_headset`, mm.

    Raises:
        ValueError: A camera has a lens that the format has no name for, or coefficients that readers disagree about.
    """
    rng = np.random.default_rng(list(path.stem.encode()))
    is_right = bool(rng.random() < _SHARE_OF_RIGHT_LOCATIONS)
    records = [_record(camera, is_right) for camera in cameras]
    order = rng.permutation(len(records))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([records[index] for index in order], allow_nan=False), encoding="utf-8")


def _record(camera: Camera, is_location_right: bool) -> dict[str, Any]:
    serial = ego_serial(camera.camera_id)
    if serial is None:
        return {
            "Camera": _block(camera, camera.camera_id),
            "MountingLocation": "Exocentric",
            "Type": "OptiTrack Color Camera",
        }
    return {
        "Camera": _block(camera, ego_calibration_name(serial)),
        "MountingLocation": "Egocentric" if is_location_right else "Exocentric",
        "Type": "CX3",
        "ParentName": "cx3-01" if serial.startswith("211") else "cx3-02",
    }


def _block(camera: Camera, serial_name: str) -> dict[str, Any]:
    model = camera.lens.model
    coefficients = dict(zip(COEFFICIENT_NAMES, camera.lens.coefficients().tolist(), strict=True))
    if model not in _MODELS or (model == "OpenCV" and any(coefficients[name] for name in ("k4", "k5", "k6"))):
        raise ValueError(
            f"Camera {camera.camera_id} has a {model} lens {coefficients}, which the format cannot say: "
            "use OpenCV with k1..k3 or OVFishEye62."
        )
    return {
        "DistortionModel": model,
        "ImageSizeX": camera.width_px,
        "ImageSizeY": camera.height_px,
        "ModelViewMatrix": camera.T_camera_from_world.tolist(),
        "SerialNo": serial_name,
        "cx": float(camera.cx_px),
        "cy": float(camera.cy_px),
        "fx": float(camera.fx_px),
        "fy": float(camera.fy_px),
        **coefficients,
    }
