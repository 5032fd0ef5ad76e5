"""Pinhole cameras as K and [R|t], as the AssemblyHands release writes them, checked."""

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.json_files import FormatError
from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole


def checked_intrinsics(K: Float64[np.ndarray, "3 3"], where: str) -> Float64[np.ndarray, "3 3"]:
    """Return K if it is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths.

    Raises:
        FormatError: It is not.
    """
    if not (K[0, 0] > 0 and K[1, 1] > 0 and K[0, 1] == K[1, 0] == 0 and (K[2] == (0, 0, 1)).all()):
        raise FormatError(f"{where}: {K.tolist()} is no matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; correct it.")
    return K


def checked_pose(Rt: Float64[np.ndarray, "3 4"], where: str) -> Float64[np.ndarray, "4 4"]:
    """Return `T_camera_from_world` of [R|t], mm.

    Raises:
        FormatError: It is not rigid.
    """
    pose = np.concatenate((Rt, [[0.0, 0.0, 0.0, 1.0]]))
    if reason := transforms.reason_not_rigid(pose):
        raise FormatError(f"{where}: its pose is refused because {reason}; get the file again.")
    return np.asarray(pose)


def pinhole_camera(
    camera_id: str, K: Float64[np.ndarray, "3 3"], pose: Float64[np.ndarray, "4 4"], size_px: tuple[int, int]
) -> Camera:
    """Return the camera of a rectified image with this K and `T_camera_from_world`."""
    fx_px, fy_px, cx_px, cy_px = (float(K[row, column]) for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(camera_id, *size_px, fx_px, fy_px, cx_px, cy_px, Pinhole(), pose)
