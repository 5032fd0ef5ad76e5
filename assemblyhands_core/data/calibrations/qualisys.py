"""Qualisys Track Manager calibrations (`.qca.txt`, XML).

The units and axes were verified by reprojection on Pose2Sim's demo (4 cameras): with the rows of r11…r33 as camera axes
the residual is the noise of the body keypoints, 16 px, with the columns 600 px.
"""

import xml.etree.ElementTree as ElementTree

import numpy as np

from assemblyhands_core.data.calibrations import UnknownFormatError
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Lens, Pinhole, lens_from_coefficients
from assemblyhands_core.geometry.transforms import MAX_NUMBER, rigid

_SUBPIXELS = 64.0  # focal lengths and principal points are stored in 1/64 px
_OUR_AXES_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])  # theirs: y up, z backward; a turn by π about x


def parse_qualisys(text: str) -> dict[str, Camera]:
    """Build the cameras of a `.qca.txt` file, video and marker cameras alike; inactive ones were not calibrated.

    Args:
        text: The document.

    Returns:
        Cameras by serial number, in the order of the file.

    Raises:
        ValueError: No Qualisys calibration, or a camera that is incomplete, double, not finite or not rigid.
    """
    if "<!DOCTYPE" in text:
        raise ValueError(
            "it declares a DOCTYPE, which no Qualisys file does and which can hide an entity bomb; remove it"
        )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UnknownFormatError(f"this is no well-formed XML ({error}); export the calibration again") from error
    if root.tag != "calibration" or "qtm-version" not in root.attrib:
        # Theia's calibrations look alike, but x, y, z are the translation there instead of the camera's centre.
        raise UnknownFormatError(
            f"its root <{root.tag}> is no Qualisys <calibration qtm-version=…>; export it as .qca.txt from QTM"
        )
    cameras: dict[str, Camera] = {}
    for element in root.iterfind("cameras/camera"):
        name = element.get("serial", "")
        if element.get("active", "1") == "0":
            continue
        if not name or name in cameras:
            raise ValueError(
                f"camera serial {name!r} is {'double' if name else 'missing'}; export the calibration again"
            )
        try:
            cameras[name] = _camera(name, element)
        except ValueError as error:
            raise ValueError(f"camera {name} is refused: {error}") from error
    return cameras


def _camera(name: str, element: ElementTree.Element) -> Camera:
    intrinsic, transform = _child(element, "intrinsic"), _child(element, "transform")
    view = _child(element, "fov_video" if element.find("fov_video") is not None else "fov_marker")
    left, top = _number(view, "left"), _number(view, "top")
    if _number(intrinsic, "skew", 0.0):
        raise ValueError("its pixels are skewed, which no camera of ours can be; calibrate it without skew")
    axes = np.array([[_number(transform, f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)])
    center_world_mm = np.array([_number(transform, axis) for axis in "xyz"])
    R_camera_from_world = _OUR_AXES_FROM_QUALISYS @ axes
    return Camera(
        camera_id=name,
        width_px=int(_number(view, "right") - left) + 1,
        height_px=int(_number(view, "bottom") - top) + 1,
        fx_px=_number(intrinsic, "focalLengthU") / _SUBPIXELS,
        fy_px=_number(intrinsic, "focalLengthV") / _SUBPIXELS,
        cx_px=_number(intrinsic, "centerPointU") / _SUBPIXELS - left,
        cy_px=_number(intrinsic, "centerPointV") / _SUBPIXELS - top,
        lens=_lens(intrinsic),
        T_camera_from_world=rigid(R_camera_from_world, -R_camera_from_world @ center_world_mm),
    )


def _lens(intrinsic: ElementTree.Element) -> Lens:
    """Read OpenCV's coefficients as they are written, without a unit.

    Pose2Sim divides them by 64 like the focal length. Its demo's own chessboard pictures say otherwise: calibrated
    afresh they give k1, k2 = -0.049, 0.133 (cam02) where the file has -0.048, 0.137, and with the file's focal length
    and centre the coefficients as written leave 0.50 and 0.58 px (cam02, cam04), divided by 64 0.58 and 0.71 px.
    """
    sources = {f"k{i}": f"radialDistortion{i}" for i in (1, 2, 3)} | {
        f"p{i}": f"tangentalDistortion{i}" for i in (1, 2)
    }
    coefficients = {name: _number(intrinsic, source, 0.0) for name, source in sources.items()}
    return lens_from_coefficients("OpenCV", coefficients) if any(coefficients.values()) else Pinhole()


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    child = element.find(tag)
    if child is None:
        raise ValueError(f"it lacks <{tag}>; export the calibration again")
    return child


def _number(element: ElementTree.Element, name: str, default: float | None = None) -> float:
    text = element.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text if text is not None else "")
    except ValueError:
        value = np.nan
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(f"<{element.tag}> {name} is {text!r} instead of a finite number; calibrate it again")
    return value
