"""Cameras: from points in the world to pixels and back.

Conventions, stated once for the whole code base
------------------------------------------------
* World and camera coordinates are in **mm**. Camera axes: x right, y down, z forward. No world axis is "up".
* `T_camera_from_world` is a rigid `(4, 4)`: `X_camera = R X_world + t`. Names of transforms state both frames.
* An integer pixel coordinate is the **centre** of a pixel: an image of width W spans [-0.5, W - 0.5], the top left
  pixel is (0, 0), x comes before y. Scaling an image by s maps `c` to `(c + 0.5) s - 0.5`.
* Rays are unit vectors. A ray or pixel that does not exist is NaN: behind a perspective camera, or outside the field
  in which the lens is one-to-one (see `distortion`).
* Computation is in float64; float32 in gives float32 out.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float64, Real

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.distortion import COEFFICIENT_NAMES, Lens, Pinhole, lens_from_coefficients

MAX_CAMERAS = 1000
"""Of a rig: some sums over its cameras go over all pairs."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera at a pose.

    Attributes:
        camera_id: Name, unique in its rig.
        width_px: Image width.
        height_px: Image height.
        fx_px: Focal length along x.
        fy_px: Focal length along y.
        cx_px: Principal point, pixel-centre convention.
        cy_px: Principal point, pixel-centre convention.
        lens: Distortion model.
        T_camera_from_world: Rigid, mm; kept as a read-only float64 copy.

    Raises:
        ValueError: A size or focal length is not positive, a number not finite or the pose not rigid.
    """

    camera_id: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    lens: Lens
    T_camera_from_world: Float[np.ndarray, "4 4"]

    def __post_init__(self) -> None:
        pose = np.array(self.T_camera_from_world, dtype=np.float64)
        pose.flags.writeable = False
        object.__setattr__(self, "T_camera_from_world", pose)
        if reason := transforms.reason_not_rigid(pose):
            raise ValueError(f"Camera {self.camera_id}: its pose is refused because {reason}; calibrate it again.")
        numbers = {name: getattr(self, name) for name in (*_POSITIVE, "cx_px", "cy_px")}
        wrong = [name for name, value in numbers.items() if not abs(value) <= transforms.MAX_NUMBER]  # nor is NaN
        wrong += [name for name in _POSITIVE if numbers[name] <= 0]
        if wrong:
            raise ValueError(
                f"Camera {self.camera_id}: {wrong[0]} is {numbers[wrong[0]]}; "
                "it must be a finite number below 1e9, sizes and focal lengths positive: correct the calibration."
            )

    @property
    def center_world_mm(self) -> Float64[np.ndarray, "3"]:
        """The centre of projection in the world."""
        return transforms.inverse(self.T_camera_from_world)[:3, 3]

    @property
    def K(self) -> Float64[np.ndarray, "3 3"]:
        """The intrinsic matrix, without the lens."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    @property
    def P_pixel_from_world(self) -> Float64[np.ndarray, "3 4"]:
        """The projection matrix from homogeneous world mm to homogeneous pixels.

        Raises:
            ValueError: The lens is not `Pinhole`, so no matrix can describe it.
        """
        if not isinstance(self.lens, Pinhole):
            raise ValueError(
                f"Camera {self.camera_id} has lens {self.lens.model}, which no matrix describes: "
                "use its rectified camera."
            )
        return np.asarray(self.K @ self.T_camera_from_world[:3])

    def to_camera(self, points_world_mm: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Move world points in mm into the camera frame."""
        return transforms.apply(self.T_camera_from_world, _floating(points_world_mm))

    def depth_mm(self, points_world_mm: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Return the z coordinate of world points in the camera frame."""
        return np.asarray(self.to_camera(points_world_mm)[..., 2])

    def project(self, points_world_mm: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Project world points with the real lens distortion.

        Returns:
            Pixels; NaN where the point lies behind the camera or outside the valid field of the lens.
        """
        points = _floating(points_world_mm)
        pixels = self.project_camera(transforms.apply(self.T_camera_from_world, points.astype(np.float64, copy=False)))
        return pixels.astype(points.dtype, copy=False)

    def unproject(self, pixels: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Return the unit rays in the world of raw (distorted) pixels, by the exact inverse of the lens.

        Returns:
            Unit vectors from `center_world_mm`; NaN outside the valid field of the lens.
        """
        given = _floating(pixels)
        rays = self.unproject_camera(given.astype(np.float64, copy=False)) @ self.T_camera_from_world[:3, :3]
        return np.asarray(rays, dtype=given.dtype)

    def project_camera(self, points_camera_mm: Real[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Map points or rays of the camera frame to pixels."""
        normalised = self.lens.distort(points_camera_mm)
        return np.asarray(normalised * self._focal_px + self._principal_px, dtype=normalised.dtype)

    def unproject_camera(self, pixels: Real[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Map pixels to unit rays of the camera frame."""
        given = _floating(pixels)
        return self.lens.undistort(((given - self._principal_px) / self._focal_px).astype(given.dtype, copy=False))

    def contains(self, pixels: Real[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
        """Tell which pixels lie on the image, which spans [-0.5, W - 0.5] × [-0.5, H - 0.5]."""
        upper = np.array([self.width_px, self.height_px]) - 0.5
        inside = (pixels >= -0.5) & (pixels <= upper)
        return np.asarray(inside[..., 0] & inside[..., 1])

    def moved(self, T_camera_from_world: Float[np.ndarray, "4 4"]) -> "Camera":
        """Return the same camera at another pose, for example a head-mounted one in the next frame."""
        return replace(self, T_camera_from_world=T_camera_from_world)

    def scaled(self, width_px: int, height_px: int) -> "Camera":
        """Return the camera of the image resized to another size; the lens is unchanged."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * sx,
            fy_px=self.fy_px * sy,
            cx_px=(self.cx_px + 0.5) * sx - 0.5,
            cy_px=(self.cy_px + 0.5) * sy - 0.5,
        )

    @property
    def _focal_px(self) -> Float64[np.ndarray, "2"]:
        return np.array([self.fx_px, self.fy_px])

    @property
    def _principal_px(self) -> Float64[np.ndarray, "2"]:
        return np.array([self.cx_px, self.cy_px])


_POSITIVE = ("width_px", "height_px", "fx_px", "fy_px")


def load_assembly101_calibration(path: str | Path) -> dict[str, Camera]:
    """Read an Assembly101 calibration: a JSON list of records `{"Camera": {...}, ...}` or of bare camera blocks.

    Args:
        path: File, as in the toolkit's `calib/nimble_json_calib` (formats 1.1-1.3).

    Returns:
        Cameras by SerialNo, in the order of the file; `ModelViewMatrix` is `T_camera_from_world` in mm.

    Raises:
        ValueError: The file is no such calibration, or a camera in it is incomplete, double, not finite or not rigid.
        OSError: The file cannot be read.
    """
    path = Path(path)
    cameras: dict[str, Camera] = {}
    records = _read_records(path)
    if len(records) > MAX_CAMERAS:
        raise ValueError(f"{path}: has {len(records)} records: no rig has more than {MAX_CAMERAS} cameras.")
    for index, record in enumerate(records):
        block = record.get("Camera", record) if isinstance(record, dict) else record
        if not isinstance(block, dict):
            raise ValueError(
                f"{path}: record {index} is no JSON object: give one object with a Camera block per camera."
            )
        name = str(block.get("SerialNo", f"record {index}"))
        if not name.isprintable():
            raise ValueError(f"{path}: camera {name[:40]!r} has signs in its name that cannot be written: rename it.")
        if name in cameras:
            raise ValueError(f"{path}: camera {name} occurs twice: remove one of its records.")
        try:
            cameras[name] = _camera_from_block(block)
        except ValueError as error:
            raise ValueError(f"{path}: camera {name} is refused: {error}") from error
    return cameras


def _read_records(path: Path) -> list[Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError as error:
        raise ValueError(f"{path}: its JSON is nested without end: export the calibration again.") from error
    except ValueError as error:  # also of bytes that are no text, and of numbers with thousands of digits
        raise ValueError(f"{path}: this is no JSON ({error}): export the calibration again.") from error
    records = [document] if isinstance(document, dict) else document
    if not isinstance(records, list) or not records:
        raise ValueError(f"{path}: expected a JSON list of camera records, got {type(document).__name__}.")
    return records


def _camera_from_block(block: Mapping[str, Any]) -> Camera:
    missing = [key for key in _BLOCK_KEYS if key not in block]
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}; export the calibration with all keys.")
    coefficients = {key: _number(block, key) for key in COEFFICIENT_NAMES if key in block}
    model = str(block["DistortionModel"])
    if model == "OpenCV" and any(coefficients[key] for key in ("k4", "k5", "k6")):
        # The toolkit ignores them and OpenCV divides by them: which one was calibrated cannot be known from the file.
        raise ValueError("k4, k5, k6 of its OpenCV lens are not 0, which has two readings; calibrate it without them.")
    return Camera(
        camera_id=str(block["SerialNo"]),
        width_px=int(_number(block, "ImageSizeX")),
        height_px=int(_number(block, "ImageSizeY")),
        fx_px=_number(block, "fx"),
        fy_px=_number(block, "fy"),
        cx_px=_number(block, "cx"),
        cy_px=_number(block, "cy"),
        lens=lens_from_coefficients(model, coefficients),
        T_camera_from_world=_pose(block["ModelViewMatrix"]),
    )


_BLOCK_KEYS = (
    *("SerialNo", "DistortionModel", "ImageSizeX", "ImageSizeY", "fx", "fy", "cx", "cy", "ModelViewMatrix"),
    *("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"),
)


def _number(block: Mapping[str, Any], key: str) -> float:
    value = block[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= transforms.MAX_NUMBER:
        raise ValueError(f"{key} is {repr(value)[:40]} instead of a finite number; correct it or calibrate again.")
    return float(value)


def _pose(value: Any) -> Float64[np.ndarray, "..."]:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ValueError("ModelViewMatrix is no 4x4 list of numbers; export the calibration again.") from None


def _floating(values: Real[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return float32 and float64 as they are and anything else as float64."""
    values = np.asarray(values)
    return values if values.dtype in (np.float32, np.float64) else values.astype(np.float64)
