"""Text files of the AssemblyHands release: rectified exocentric cameras (`calib.txt`) and `skeleton.txt` (formats 2).

`calib.txt` has eight lines for each camera, blank lines aside: its name, three rows of K, a row that nobody reads, and
three rows of [R|t], world to camera in mm.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.camera_matrices import checked_intrinsics, checked_pose, pinhole_camera
from assemblyhands_core.data.json_files import FormatError, read_bytes
from assemblyhands_core.data.names import checked_component
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.hands.joints import BONES, FINGERS, HANDS, NUM_JOINTS

MAX_TEXT_BYTES: Final = 2**20
_LINES_PER_CAMERA: Final = 8
_NO_PARENT: Final = -1
_NUMBER: Final = re.compile(r"-?\d{1,6}", re.ASCII)


def write_exo_calibration(path: Path, cameras: Iterable[Camera]) -> None:
    """Write the `calib.txt` of rectified cameras.

    Raises:
        ValueError: A camera is not rectified, or its K has no place for what it is.
    """
    blocks = []
    for camera in cameras:
        if not isinstance(camera.lens, Pinhole):
            raise ValueError(f"Camera {camera.camera_id} has a {camera.lens.model} lens: write its rectified camera.")
        rows = [*camera.K.tolist(), [0.0] * 5, *camera.T_camera_from_world[:3].tolist()]
        blocks.append("\n".join([camera.camera_id, *(" ".join(map(repr, row)) for row in rows)]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def read_exo_calibration(path: Path, size_px: tuple[int, int] = (1920, 1080)) -> dict[str, Camera]:
    """Read a `calib.txt`; cameras by name in the order of the file.

    Args:
        path: The file.
        size_px: Width and height of the rectified images, which the file does not say.

    Raises:
        FormatError: The file is too large or cut off, or a camera is incomplete, double or impossible.
    """
    lines = _lines(path)
    if not lines or len(lines) % _LINES_PER_CAMERA:
        raise FormatError(f"{path}: has {len(lines)} lines, not {_LINES_PER_CAMERA} for each camera; get it again.")
    cameras: dict[str, Camera] = {}
    for start in range(0, len(lines), _LINES_PER_CAMERA):
        name = checked_component(lines[start], f"{path}: a camera")
        if name in cameras:
            raise FormatError(f"{path}: camera {name} occurs twice; keep one of them.")
        cameras[name] = _camera(name, lines[start + 1 : start + _LINES_PER_CAMERA], size_px, f"{path}: camera {name}")
    return cameras


def write_skeleton(path: Path) -> None:
    """Write `skeleton.txt`: name, number and parent's number of both hands' joints, r_thumb4 (the tip) to l_wrist."""
    parents = dict(BONES)
    rows = [
        f"{hand[0]}_{name} {first + joint} {first + parents[joint] if joint in parents else _NO_PARENT}"
        for first, hand in zip((0, NUM_JOINTS), HANDS, strict=True)
        for joint, name in enumerate(_release_names())
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["# name id parent_id", *rows]) + "\n", encoding="utf-8")


def read_skeleton(path: Path) -> list[tuple[str, int]]:
    """Read a `skeleton.txt`: name and parent (-1 for none) of each joint, in the order of their numbers.

    Raises:
        FormatError: A line is not name, number and parent, or the numbers do not count from 0.
    """
    joints: list[tuple[str, int]] = []
    for line in _lines(path):
        if line.startswith("#"):
            continue
        parts = line.split()
        if len(parts) != 3 or parts[1] != str(len(joints)) or not _NUMBER.fullmatch(parts[2]):
            raise FormatError(f"{path}: {line[:60]!r} is not name, {len(joints)} and parent; get the file again.")
        joints.append((parts[0], int(parts[2])))
    return joints


def _release_names() -> list[str]:
    return [*(f"{finger}{number}" for finger in FINGERS for number in (4, 3, 2, 1)), "wrist"]


def _lines(path: Path) -> list[str]:
    try:
        text = read_bytes(path, MAX_TEXT_BYTES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: is no text; get the file again.") from error
    return [line.strip() for line in text.splitlines() if line.strip()]


def _camera(name: str, rows: list[str], size_px: tuple[int, int], where: str) -> Camera:
    K = checked_intrinsics(_matrix(rows[:3], 3, where), where)
    return pinhole_camera(name, K, checked_pose(_matrix(rows[4:], 4, where), where), size_px)


def _matrix(rows: list[str], columns: int, where: str) -> Float64[np.ndarray, "3 columns"]:
    parts = [row.split() for row in rows]
    try:
        matrix = np.array([[float(value) for value in row] for row in parts], dtype=np.float64)
    except ValueError:
        matrix = np.array([])
    if matrix.shape != (3, columns) or not np.isfinite(matrix).all():
        raise FormatError(f"{where}: {rows} are not 3 rows of {columns} finite numbers; get the file again.")
    return matrix
