"""2D keypoints that another program has found, read from files in place of images.

* a Parquet file with the columns ``camera``, ``frame``, ``person`` (bodies) or ``hand`` (``right``/``left``),
  ``keypoints_px`` (34 or 42 numbers, x and y in turn, COCO-17 or AssemblyHands order, raw pixels) and ``confidence``
  (17 or 21); or
* a folder as OpenPose and Pose2Sim write it: ``<folder>/<camera>/…_000000000012_keypoints.json`` (the camera's folder
  may end in ``_json``; the last number of the name is the frame).

Keypoints with confidence 0 are missing. Results are in raw pixels of the camera's image.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.detectors._keypoint_files import OpenPoseFolder, ParquetKeypoints
from assemblyhands_core.detectors.base import BodyDetections, DetectorError, HandDetection, ImageRGB, masked
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS, Hand


@runtime_checkable
class _Source(Protocol):
    def bodies(self, camera_id: str, frame: int) -> Float64[np.ndarray, "detection keypoint=17 3"]: ...

    def hands(self, hand: Hand, camera_id: str, frame: int) -> Float64[np.ndarray, "detection joint=21 3"]: ...


class PrecomputedBody:
    """Bodies from a Parquet file or an OpenPose folder."""

    needs_image = False

    def __init__(self, root: str | Path | None = None) -> None:
        """Open the keypoints.

        Args:
            root: a Parquet file, or the folder that holds the cameras' folders of JSON files.

        Raises:
            DetectorError: it is absent or not what this module reads.
        """
        self._source = _open(root, "person", NUM_BODY_KEYPOINTS)

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return the persons stored for that camera and frame; the image is not looked at."""
        persons = self._source.bodies(camera_id, frame)
        keypoints_px, confidence = masked(persons[..., :2], persons[..., 2])
        is_somebody = (confidence > 0).any(axis=-1)
        return BodyDetections(keypoints_px[is_somebody], confidence[is_somebody])


class PrecomputedHands:
    """Hands from a Parquet file or an OpenPose folder."""

    needs_image = False

    def __init__(self, root: str | Path | None = None) -> None:
        """Open the keypoints.

        Args:
            root: a Parquet file, or the folder that holds the cameras' folders of JSON files.

        Raises:
            DetectorError: it is absent or not what this module reads.
        """
        self._source = _open(root, "hand", NUM_JOINTS)

    def detect(
        self,
        image_rgb: ImageRGB | None,
        hand: Hand,
        camera_id: str,
        frame: int,
        expected_px: Float64[np.ndarray, "2"] | None = None,
    ) -> HandDetection | None:
        """Return the stored hand nearest to ``expected_px`` in raw px, by default the most confident one."""
        stored = self._source.hands(hand, camera_id, frame)
        hands = [(k, c) for k, c in (masked(h[:, :2], h[:, 2]) for h in stored) if (c > 0).any()]
        if not hands:
            return None
        if expected_px is None:
            return HandDetection(*max(hands, key=lambda found: float(found[1].sum())))
        nearest = min(hands, key=lambda found: float(np.linalg.norm(np.nanmean(found[0], axis=0) - expected_px)))
        return HandDetection(*nearest)


def fingerprint(options: Mapping[str, Any]) -> dict[str, str]:
    """Return one sha256 over the names and contents of the files read."""
    root = _existing(options.get("root"))
    if root.is_file():
        return {"sha256": digest_file(root)}
    digest = hashlib.sha256()
    for file in sorted(root.rglob("*.json")):
        digest.update(f"{file.relative_to(root).as_posix()}\0{digest_file(file)}\n".encode())
    return {"sha256": digest.hexdigest()}


def _open(root: str | Path | None, kind: str, num_keypoints: int) -> _Source:
    path = _existing(root)
    return OpenPoseFolder(path) if path.is_dir() else ParquetKeypoints(path, kind, num_keypoints)


def _existing(root: str | Path | None) -> Path:
    if root is None or not Path(root).exists():
        what = "has no option root" if root is None else f"is to read {root}, which does not exist"
        raise DetectorError(f"Detector 'precomputed' {what}: set it to a Parquet file or a folder of OpenPose JSON.")
    return Path(root)
