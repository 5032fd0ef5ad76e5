"""RTMPose through rtmlib: better than mediapipe, for machines that may download its weights."""

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.detectors._packages import import_package, package_version
from assemblyhands_core.detectors.base import (
    BodyDetections,
    DetectorError,
    HandDetection,
    ImageRGB,
    from_wrist_first,
    masked,
)
from assemblyhands_core.hands.joints import Hand

_INSTALL: Final = "pip install rtmlib onnxruntime"


class RtmlibBody:
    """Persons by YOLOX and RTMPose (COCO-17)."""

    needs_image = True

    def __init__(
        self,
        max_persons: int = 2,
        mode: Literal["lightweight", "balanced", "performance"] = "balanced",
        det: str | None = None,
        pose: str | None = None,
        backend: str = "onnxruntime",
        device: str = "cpu",
    ) -> None:
        """Load the models; the first use on a machine downloads them.

        Args:
            max_persons: at most so many persons are returned, the surest first.
            mode: size of the models.
            det: path or address of the person detector (ONNX) in place of the mode's.
            pose: path or address of the pose model (ONNX) in place of the mode's.
            backend: ``onnxruntime``, ``opencv`` or ``openvino``.
            device: ``cpu``, ``cuda`` …

        Raises:
            DetectorError: rtmlib is not installed or its weights cannot be had.
        """
        self._max_persons = max_persons
        self._model = _load("Body", mode=mode, det=det, pose=pose, backend=backend, device=device)

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return up to ``max_persons`` persons of the image."""
        image = _bgr(image_rgb, camera_id, frame)
        boxes = self._model.det_model(image)
        if len(boxes) == 0:  # the pose model would take the whole image for a person
            return BodyDetections.none()
        keypoints, scores = self._model.pose_model(image, bboxes=boxes)
        keypoints_px, confidence = masked(np.asarray(keypoints, np.float64), np.asarray(scores, np.float64))
        surest = np.argsort(-confidence.mean(axis=-1), kind="stable")[: self._max_persons]
        return BodyDetections(keypoints_px[surest], confidence[surest])


class RtmlibHands:
    """One hand of a crop by RTMDet and RTMPose (21 keypoints, OpenPose order)."""

    needs_image = True

    def __init__(
        self,
        mode: Literal["lightweight"] = "lightweight",
        det: str | None = None,
        pose: str | None = None,
        backend: str = "onnxruntime",
        device: str = "cpu",
    ) -> None:
        """Load the models; the first use on a machine downloads them.

        Args:
            mode: size of the models; rtmlib has one.
            det: path or address of the hand detector (ONNX) in place of rtmlib's.
            pose: path or address of the hand pose model (ONNX) in place of rtmlib's.
            backend: ``onnxruntime``, ``opencv`` or ``openvino``.
            device: ``cpu``, ``cuda`` …

        Raises:
            DetectorError: rtmlib is not installed or its weights cannot be had.
        """
        self._model = _load("Hand", mode=mode, det=det, pose=pose, backend=backend, device=device)

    def detect(
        self,
        image_rgb: ImageRGB | None,
        hand: Hand,
        camera_id: str,
        frame: int,
        expected_px: Float64[np.ndarray, "2"] | None = None,
    ) -> HandDetection | None:
        """Return the hand of a crop nearest to ``expected_px``; these models do not tell right from left.

        Where the hand detector finds nothing the whole crop is taken for the hand; the confidence tells.
        """
        image = _bgr(image_rgb, camera_id, frame)
        height, width = image.shape[:2]
        boxes = self._model.det_model(image)
        whole = [[0, 0, width, height]]
        keypoints, scores = self._model.pose_model(image, bboxes=boxes if len(boxes) else whole)
        center = np.array([(width - 1) / 2, (height - 1) / 2]) if expected_px is None else expected_px
        hands = np.asarray(keypoints, np.float64)
        nearest = int(np.linalg.norm(hands.mean(axis=1) - center, axis=-1).argmin())
        confidence = np.asarray(scores, np.float64)[nearest]
        return HandDetection(*masked(from_wrist_first(hands[nearest]), from_wrist_first(confidence)))


def fingerprint(options: Mapping[str, Any]) -> dict[str, str]:
    """Return rtmlib's version and the sha256 of weights given as files; rtmlib's own are named by the version."""
    weights = {key: Path(str(options[key])) for key in ("det", "pose") if options.get(key)}
    return {"rtmlib": package_version("rtmlib", _INSTALL)} | {
        key: digest_file(path) for key, path in weights.items() if path.is_file()
    }


def _load(solution: str, **options: Any) -> Any:
    rtmlib = import_package("rtmlib", _INSTALL)
    if options["backend"] == "onnxruntime":
        import_package("onnxruntime", _INSTALL)
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # rtmlib prints when it loads a model
            return getattr(rtmlib, solution)(**{key: value for key, value in options.items() if value is not None})
    except OSError as error:
        raise DetectorError(
            f"rtmlib cannot fetch the weights of its {solution} ({error}): give files by the options det and pose, "
            "or use detector mediapipe, which ships with its weights."
        ) from error


def _bgr(image_rgb: ImageRGB | None, camera_id: str, frame: int) -> ImageRGB:
    if image_rgb is None:
        raise DetectorError(f"rtmlib needs the image of {camera_id} frame {frame}.")
    return np.ascontiguousarray(image_rgb[:, :, ::-1])
