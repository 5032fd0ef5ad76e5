"""AssemblyHands annotations: 3D joints, and the headset cameras of every frame (formats 2.3, 2.5).

Frames are named by six digits that count at **60 Hz** although joints are given at 30 Hz, so that keys step by 2: frame
n of a 30 Hz video that begins with the first key is key first + 2 n. World coordinates in mm; joints in the order of
`hands.joints`, right hand first.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from assemblyhands_core.data.camera_matrices import checked_intrinsics, checked_pose, pinhole_camera
from assemblyhands_core.data.json_files import (
    FormatError,
    counted_problems,
    json_object,
    kind_of,
    member,
    numbers,
    read_json_object,
    write_json,
)
from assemblyhands_core.data.names import checked_component, ego_calibration_name
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS

KEY_RATE_HZ: Final = 60
KEYS_PER_VIDEO_FRAME: Final = 2
EGO_SIZE_PX: Final = (636, 480)
RECTIFIED_FOCAL_SCALE: Final = 0.7
"""Focal length of the release's rectified egocentric images, as a factor on the fisheye's (formats 2.5)."""

_MAX_CAMERAS: Final = 8
_KEY: Final = re.compile(r"\d{6}", re.ASCII)


@dataclass(frozen=True, eq=False)
class JointAnnotations:
    """The joints of both hands at some instants of a recording.

    Attributes:
        frames_60hz: Ascending.
        joints_world_mm: Right hand first; NaN where not valid.
        is_valid: Which joints were annotated.

    Raises:
        ValueError: Frames do not ascend, or a valid joint is not finite.
    """

    frames_60hz: Int64[np.ndarray, " frame"]
    joints_world_mm: Float64[np.ndarray, "frame hand=2 joint=21 xyz=3"]
    is_valid: Bool[np.ndarray, "frame hand=2 joint=21"]

    def __post_init__(self) -> None:
        _check_frames(self.frames_60hz)
        lost = self.is_valid & ~np.isfinite(self.joints_world_mm).all(axis=-1)
        if lost.any():
            frame, hand, joint = np.argwhere(lost)[0]
            raise ValueError(
                f"frame {self.frames_60hz[frame]}: joint {joint} of the {HANDS[hand]} hand is called valid but is not "
                "finite; correct it or mark it invalid."
            )


@dataclass(frozen=True, eq=False)
class EgoCalibration:
    """The rectified cameras of a headset at every frame of a recording.

    Attributes:
        camera_ids: As `names.ego_video_name` spells them.
        K_px: Intrinsic matrix of each rectified camera.
        frames_60hz: Ascending.
        T_camera_from_world: Pose of every camera at every frame, mm; NaN where a frame lacks the camera.

    Raises:
        ValueError: Frames do not ascend.
    """

    camera_ids: tuple[str, ...]
    K_px: Float64[np.ndarray, "camera 3 3"]
    frames_60hz: Int64[np.ndarray, " frame"]
    T_camera_from_world: Float64[np.ndarray, "frame camera 4 4"]

    def __post_init__(self) -> None:
        _check_frames(self.frames_60hz)

    def poses_at(self, frame_60hz: int) -> dict[str, Float64[np.ndarray, "4 4"]]:
        """Return `T_camera_from_world` of the cameras that a frame has; none for a frame that the file lacks."""
        index = int(np.searchsorted(self.frames_60hz, frame_60hz))
        if index == len(self.frames_60hz) or self.frames_60hz[index] != frame_60hz:
            return {}
        poses = self.T_camera_from_world[index]
        return {name: pose for name, pose in zip(self.camera_ids, poses, strict=True) if np.isfinite(pose).all()}

    def rectified_at(self, frame_60hz: int, size_px: tuple[int, int] = EGO_SIZE_PX) -> dict[str, Camera]:
        """Return the pinhole cameras of a frame's rectified images; the file does not say their size."""
        matrices = dict(zip(self.camera_ids, self.K_px, strict=True))
        return {
            name: pinhole_camera(name, matrices[name], pose, size_px)
            for name, pose in self.poses_at(frame_60hz).items()
        }

    def raw_at(self, frame_60hz: int, calibration: Mapping[str, Camera]) -> dict[str, Camera]:
        """Return the fisheye cameras of a frame's raw videos: lenses of the recording's calibration, poses from here.

        Args:
            frame_60hz: The frame.
            calibration: The recording's Assembly101 calibration; its egocentric poses, in the headset, are not used.

        Raises:
            ValueError: The calibration lacks a camera of the frame.
        """
        names = {name: ego_calibration_name(name) for name in self.poses_at(frame_60hz)}
        if missing := set(names.values()) - set(calibration):
            raise ValueError(f"the calibration has no camera {', '.join(sorted(missing))}; use this recording's own.")
        return {
            name: replace(calibration[names[name]], camera_id=name, T_camera_from_world=pose)
            for name, pose in self.poses_at(frame_60hz).items()
        }


def write_joint_annotations(path: Path, recordings: Mapping[str, JointAnnotations]) -> None:
    """Write a `joint_3d` file; coordinates of invalid joints are written as 0."""
    annotations = {name: _joint_blocks(joints) for name, joints in recordings.items()}
    write_json(path, {"info": {"unit": "mm", "rate_hz": KEY_RATE_HZ}, "annotations": annotations})


def read_joint_annotations(path: Path, recording: str | None = None) -> dict[str, JointAnnotations]:
    """Read a `joint_3d` file, all recordings or one.

    Returns:
        By recording; `joint_valid` may be flat or a column, any number above 0 means valid.

    Raises:
        FormatError: File, recording, frame or joint are not as they should be; the message says which and why.
    """
    recordings = json_object(member(read_json_object(path), "annotations", str(path)), f"{path}: annotations")
    return {
        checked_component(name, f"{path}: a recording"): _read_joints(frames, f"{path}: {name}")
        for name, frames in recordings.items()
        if recording in (None, name)
    }


def write_ego_calibration(path: Path, recordings: Mapping[str, EgoCalibration]) -> None:
    """Write an `ego_calib` file: intrinsics of the rectified images, and [R|t] from world to camera at each frame."""
    write_json(path, {"calibration": {name: _calibration_block(ego) for name, ego in recordings.items()}})


def read_ego_calibration(path: Path, recording: str | None = None) -> dict[str, EgoCalibration]:
    """Read an `ego_calib` file, all recordings or one; by recording, cameras in the order of its intrinsics.

    Raises:
        FormatError: File, recording, frame or camera are not as they should be; the message says which and why.
    """
    recordings = json_object(member(read_json_object(path), "calibration", str(path)), f"{path}: calibration")
    return {
        checked_component(name, f"{path}: a recording"): _read_ego(json_object(block, where), where)
        for name, block in recordings.items()
        if recording in (None, name)
        for where in [f"{path}: {name}"]
    }


def frame_key(frame_60hz: int) -> str:
    """Return the six digits that name a frame.

    Raises:
        ValueError: Six digits cannot say it.
    """
    if not 0 <= frame_60hz < 10**6:
        raise ValueError(f"frame {frame_60hz} has no name of six digits; keep recordings below 4.6 h at 60 Hz.")
    return f"{frame_60hz:06d}"


def _joint_blocks(joints: JointAnnotations) -> dict[str, Any]:
    coordinates = np.where(joints.is_valid[..., None], joints.joints_world_mm, 0.0).reshape(-1, NUM_BOTH, 3)
    valid = joints.is_valid.reshape(-1, NUM_BOTH).astype(int)
    return {
        frame_key(int(frame)): {"world_coord": world.tolist(), "joint_valid": flags.tolist()}
        for frame, world, flags in zip(joints.frames_60hz, coordinates, valid, strict=True)
    }


def _read_joints(blocks: object, where: str) -> JointAnnotations:
    frames = _by_frame(blocks, where)
    found: list[tuple[Float64[np.ndarray, "joint=42 3"], Bool[np.ndarray, "joint=42"]]] = []
    with counted_problems() as problems:
        for frame, value in frames.items():
            with problems.noted():
                found.append(_read_frame(value, f"{where}, frame {frame_key(frame)}"))
    world = np.array([np.where(flags[:, None], joints, np.nan) for joints, flags in found])
    is_valid, shape = np.array([flags for _, flags in found], dtype=bool), (len(found), len(HANDS), NUM_JOINTS)
    return JointAnnotations(np.array(list(frames), dtype=np.int64), world.reshape(*shape, 3), is_valid.reshape(shape))


def _read_frame(value: object, place: str) -> tuple[Float64[np.ndarray, "joint=42 3"], Bool[np.ndarray, "joint=42"]]:
    block = json_object(value, place)
    flags = joint_flags(member(block, "joint_valid", place), f"{place}, joint_valid")
    joints = numbers(member(block, "world_coord", place), (NUM_BOTH, 3), f"{place}, world_coord", is_finite=False)
    if not np.isfinite(joints[flags]).all():
        raise FormatError(f"{place}, world_coord: a valid joint is not finite; correct it or mark it invalid.")
    return joints, flags


def joint_flags(value: object, where: str) -> Bool[np.ndarray, "joint=42"]:
    """Return which joints are valid: 42 numbers or flags, flat or in a column; above 0 means valid."""
    is_column = isinstance(value, list) and len(value) == NUM_BOTH and isinstance(value[0], list)
    if isinstance(value, list) and all(isinstance(flag, bool) for flag in value):
        value = [int(flag) for flag in value]
    return np.asarray(numbers(value, (NUM_BOTH, 1) if is_column else (NUM_BOTH,), where).ravel() > 0)


def _calibration_block(ego: EgoCalibration) -> dict[str, Any]:
    return {
        "intrinsics": {name: K.tolist() for name, K in zip(ego.camera_ids, ego.K_px, strict=True)},
        "extrinsics": {
            frame_key(int(frame)): {name: pose[:3].tolist() for name, pose in ego.poses_at(int(frame)).items()}
            for frame in ego.frames_60hz
        },
    }


def _read_ego(block: Mapping[str, Any], where: str) -> EgoCalibration:
    intrinsics = json_object(member(block, "intrinsics", where), f"{where}, intrinsics")
    if len(intrinsics) > _MAX_CAMERAS:
        raise FormatError(f"{where}: has {len(intrinsics)} cameras, no headset has more than {_MAX_CAMERAS}.")
    camera_ids = tuple(checked_component(name, f"{where}: a camera") for name in intrinsics)
    matrices = np.zeros((len(camera_ids), 3, 3))
    for index, (name, value) in enumerate(intrinsics.items()):
        place = f"{where}, intrinsics of {name}"
        matrices[index] = checked_intrinsics(numbers(value, (3, 3), place), place)
    found = _by_frame(member(block, "extrinsics", where), f"{where}, extrinsics")
    frames = {frame: cameras for frame, cameras in found.items() if cameras != {}}  # as if the file lacked the others
    poses = np.full((len(frames), len(camera_ids), 4, 4), np.nan)
    with counted_problems() as problems:
        for index, (frame, cameras) in enumerate(frames.items()):
            place = f"{where}, extrinsics of frame {frame_key(frame)}"
            for name, value in json_object(cameras, place).items():
                with problems.noted():
                    if name not in camera_ids:
                        raise FormatError(f"{place}: camera {kind_of(name)} has no intrinsics; get the file again.")
                    there = f"{place}, camera {name}"
                    poses[index, camera_ids.index(name)] = checked_pose(numbers(value, (3, 4), there), there)
    return EgoCalibration(camera_ids, matrices, np.array(list(frames), dtype=np.int64), poses)


def _by_frame(blocks: object, where: str) -> dict[int, Any]:
    """Return the entries of a recording by frame, ascending."""
    entries = json_object(blocks, where)
    for key in entries:
        if not _KEY.fullmatch(key):
            raise FormatError(f"{where}: {kind_of(key)} is no frame; frames are named by six digits.")
    return {int(key): entries[key] for key in sorted(entries)}


def _check_frames(frames: Int64[np.ndarray, " frame"]) -> None:
    if (np.diff(frames) <= 0).any():
        raise ValueError(f"the frames {frames[:5].tolist()}… do not ascend; sort them and keep each once.")
