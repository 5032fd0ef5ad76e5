"""anipose and Pose2Sim calibrations (TOML): one table per camera with OpenCV's intrinsics and world-to-camera pose."""

import tomllib
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from assemblyhands_core.data.calibrations import UnknownFormatError
from assemblyhands_core.geometry.cameras import MAX_CAMERAS, Camera
from assemblyhands_core.geometry.distortion import Lens, Pinhole, lens_from_coefficients
from assemblyhands_core.geometry.transforms import MAX_NUMBER, rigid

LengthUnit = Literal["auto", "mm", "m"]

_KEYS = ("size", "matrix", "distortions", "rotation", "translation")
_OPENCV_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_MAX_DOTS = 1000  # the parser takes quadratic time for keys like a.a.a.a
_MAX_RIG_SIZE = 100.0  # cameras nearer together than 100 mm, or farther apart than 100 m, are no rig of this program


def parse_anipose(text: str, unit: LengthUnit = "auto") -> dict[str, Camera]:
    """Build the cameras of an anipose or Pose2Sim TOML file.

    The file does not say its unit of length: Pose2Sim writes metres, anipose that of the board, usually mm. `auto`
    takes mm where cameras are 100 units or more apart, metres where they are nearer together and the tables have the
    key `fisheye` that Pose2Sim always writes, and refuses to guess otherwise.

    Args:
        text: The document.
        unit: Unit of the translations.

    Returns:
        Cameras by name (key `name`, else the table's), in the order of the file; none if no table is a camera.

    Raises:
        ValueError: No TOML, a camera that is incomplete, double, fisheye, not finite or not rigid, or an unclear unit.
    """
    if any(line.count(".") > _MAX_DOTS for line in text.splitlines()):
        raise UnknownFormatError(f"it has a line of more than {_MAX_DOTS} dots, which no calibration has")
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of numbers with thousands of digits
        raise UnknownFormatError(f"this is no well-formed TOML ({error}); export the calibration again") from error
    tables = {key: table for key, table in document.items() if isinstance(table, dict) and "matrix" in table}
    if len(tables) > MAX_CAMERAS:
        raise ValueError(f"it has {len(tables)} tables of cameras: no rig has more than {MAX_CAMERAS}")
    cameras: dict[str, Camera] = {}
    for key, table in tables.items():
        name = str(table.get("name", key))
        if name in cameras:
            raise ValueError(f"camera {name} occurs twice; rename one of them")
        try:
            cameras[name] = _camera(name, table)
        except ValueError as error:
            raise ValueError(f"camera {name} is refused: {error}") from error
    is_pose2sim = all("fisheye" in table for table in tables.values())
    scale = {"mm": 1.0, "m": 1000.0}[_unit(cameras, is_pose2sim) if unit == "auto" else unit] if cameras else 1.0
    return {name: _with_scaled_translation(camera, scale) for name, camera in cameras.items()}


def _camera(name: str, table: dict[str, Any]) -> Camera:
    if missing := [key for key in _KEYS if key not in table]:
        raise ValueError(f"it lacks {', '.join(missing)}; export the calibration with all keys")
    if table.get("fisheye", False):
        raise ValueError(
            "fisheye = true is OpenCV's fisheye model, which is not supported; calibrate it without fisheye"
        )
    size, matrix = _array(table, "size", (2,)), _array(table, "matrix", (3, 3))
    if matrix[0, 1] or not np.array_equal(matrix * [[0, 0, 0], [1, 0, 0], [1, 1, 1]], np.diag([0, 0, 1])):
        raise ValueError(f"matrix is {matrix.tolist()} instead of [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; correct it")
    return Camera(
        camera_id=name,
        width_px=int(size[0]),
        height_px=int(size[1]),
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
        lens=_lens(table),
        T_camera_from_world=rigid(_rotation(_array(table, "rotation", (3,))), _array(table, "translation", (3,))),
    )


def _lens(table: dict[str, Any]) -> Lens:
    values = _array(table, "distortions", (-1,)).tolist()
    if any(values[len(_OPENCV_ORDER) :]):
        raise ValueError("its distortions go beyond k6 (thin prism), which is not supported; calibrate it with 5 terms")
    coefficients = dict(zip(_OPENCV_ORDER, values, strict=False))
    return lens_from_coefficients("OpenCV", coefficients) if any(values) else Pinhole()


def _rotation(vector: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Rotation matrix of an axis times an angle in radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle if angle else vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: npt.NDArray[np.float64] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return rotation


def _array(table: dict[str, Any], key: str, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    try:
        array = np.array(table[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.ndim != len(shape) or (shape != (-1,) and array.shape != shape) or not (np.abs(array) <= MAX_NUMBER).all():
        wanted = " x ".join(str(side) for side in shape).replace("-1", "n")
        raise ValueError(
            f"{key} is {str(table[key])[:80]} instead of {wanted} finite numbers; correct it or calibrate again"
        )
    return array


def _unit(cameras: dict[str, Camera], is_pose2sim: bool) -> Literal["mm", "m"]:
    centers = np.array([camera.center_world_mm for camera in cameras.values()])
    spread = float(np.linalg.norm(centers[:, None] - centers[None], axis=-1).max())
    if spread >= _MAX_RIG_SIZE:
        return "mm"
    if is_pose2sim:
        return "m"
    raise ValueError(
        f"its unit of length is unclear (the cameras are up to {spread:.3g} units apart, with no mark of Pose2Sim); "
        "say it: ingest.length_unit=mm or m"
    )


def _with_scaled_translation(camera: Camera, scale: float) -> Camera:
    pose = camera.T_camera_from_world
    return camera.moved(rigid(pose[:3, :3], pose[:3, 3] * scale))
