"""MediaPipe's body and hand detectors (0.10.14 ships their weights in the wheel and runs offline)."""

import os
import warnings
from collections.abc import Mapping
from typing import Any, Final

import cv2
import numpy as np

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.detectors._mediapipe_hands import HandLandmarkModel, close_with, landmarks_px, search_hand
from assemblyhands_core.detectors._packages import import_package, package_folder, package_version
from assemblyhands_core.detectors.base import (
    BodyDetections,
    DetectorError,
    FloatArray,
    HandDetection,
    ImageRGB,
    from_wrist_first,
    masked,
)
from assemblyhands_core.hands.body import BODY_BONES
from assemblyhands_core.hands.joints import Hand

_INSTALL: Final = "pip install --no-deps mediapipe==0.10.14"

# Which of BlazePose's 33 landmarks each COCO-17 keypoint is.
COCO_FROM_BLAZEPOSE: Final = (0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)

_MODEL_FILES: Final = (
    "modules/pose_detection/pose_detection.tflite",
    "modules/pose_landmark/pose_landmark_full.tflite",
    "modules/hand_landmark/hand_landmark_full.tflite",
    "modules/hand_landmark/hand_landmark_lite.tflite",
)

_NEUTRAL_GRAY: Final = (128, 128, 128)
_MIN_BODY_KEYPOINTS: Final = 6
_NECK_BONES: Final = ((0, 5), (0, 6))


class MediapipeBody:
    """Persons by BlazePose; further persons by looking again with those already found painted over."""

    needs_image = True

    def __init__(self, max_persons: int = 2, min_confidence: float = 0.5, model_complexity: int = 1) -> None:
        """Load the models.

        Args:
            max_persons: how many persons to look for; each costs one more pass (~40 ms on one core).
            min_confidence: detection threshold, and the mean visibility below which a further person does not count.
            model_complexity: 1; the wheel does not hold the others.

        Raises:
            DetectorError: mediapipe is not installed, or another complexity was asked for.
        """
        if model_complexity != 1:
            raise DetectorError(f"mediapipe's wheel holds only the body model of complexity 1, not {model_complexity}.")
        self._max_persons = max_persons
        self._min_confidence = min_confidence
        # Static mode: without tracking from frame to frame a result depends on its image alone.
        _silence()
        self._pose = import_package("mediapipe.python.solutions.pose", _INSTALL).Pose(
            static_image_mode=True, model_complexity=model_complexity, min_detection_confidence=min_confidence
        )
        close_with(self, self._pose.close)

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return up to ``max_persons`` persons of the image (H, W, 3)."""
        image = _contiguous(image_rgb, camera_id, frame)
        persons: list[tuple[FloatArray, FloatArray]] = []
        while len(persons) < self._max_persons:
            landmarks = self._pose.process(image).pose_landmarks
            if landmarks is None:
                break
            found = body_from_landmarks(landmarks.landmark, image.shape[1], image.shape[0])
            if not self._is_new(found, [keypoints for keypoints, _ in persons]):
                break
            persons.append(found)
            if len(persons) < self._max_persons:
                image = paint_over(image, found[0])
        if not persons:
            return BodyDetections.none()
        return BodyDetections(np.stack([k for k, _ in persons]), np.stack([c for _, c in persons]))

    def _is_new(self, found: tuple[FloatArray, FloatArray], known: list[FloatArray]) -> bool:
        keypoints_px, confidence = found
        if not known:
            return True
        if np.median(confidence) < self._min_confidence or (confidence > 0).sum() < _MIN_BODY_KEYPOINTS:
            return False
        return all(_is_elsewhere(keypoints_px, other) for other in known)


class MediapipeHands:
    """One hand of a crop by MediaPipe's hand landmark model."""

    needs_image = True

    def __init__(
        self,
        min_confidence: float = 0.5,
        model_complexity: int = 1,
        region: float = 0.75,
        num_directions: int = 4,
        num_refinements: int = 2,
    ) -> None:
        """Load the model.

        Args:
            min_confidence: least belief of the model that it sees a hand.
            model_complexity: 0 or 1; 0 is faster and finds less.
            region: share of the crop's side that is looked at first.
            num_directions: in how many directions the fingers may point at first.
            num_refinements: how often the region is placed anew around the hand found.

        Raises:
            DetectorError: mediapipe is not installed.
        """
        _silence()
        self._model = HandLandmarkModel(model_complexity, _INSTALL)
        self._min_confidence = min_confidence
        self._region = region
        self._num_directions = num_directions
        self._num_refinements = num_refinements

    def detect(
        self,
        image_rgb: ImageRGB | None,
        hand: Hand,
        camera_id: str,
        frame: int,
        expected_px: FloatArray | None = None,
    ) -> HandDetection | None:
        """Return the hand of a crop (H, W, 3), every joint as sure as the hand; None where no hand is found."""
        image = _contiguous(image_rgb, camera_id, frame)
        height, width = image.shape[:2]
        center = np.array([(width - 1) / 2, (height - 1) / 2]) if expected_px is None else expected_px
        side_px = self._region * min(height, width)
        look = search_hand(self._model, image, hand, center, side_px, self._num_directions, self._num_refinements)
        if look.presence < self._min_confidence:
            return None
        keypoints_px = from_wrist_first(look.keypoints_px)
        return HandDetection(*masked(keypoints_px, np.full(len(keypoints_px), look.presence)))


def body_from_landmarks(landmarks: Any, width_px: int, height_px: int) -> tuple[FloatArray, FloatArray]:
    """Return COCO-17 keypoints (17, 2) px and their visibility (17,) of BlazePose's 33 landmarks.

    Landmarks outside the image are extrapolated by the model, not seen: they are missing.
    """
    keypoints = landmarks_px(landmarks, width_px, height_px)[list(COCO_FROM_BLAZEPOSE)]
    visibility = np.array([landmarks[i].visibility for i in COCO_FROM_BLAZEPOSE], dtype=np.float64)
    inside = ((keypoints >= -0.5) & (keypoints <= np.array([width_px, height_px]) - 0.5)).all(axis=-1)
    return masked(keypoints, np.where(inside, visibility, 0.0))


def paint_over(image_rgb: ImageRGB, keypoints_px: FloatArray) -> ImageRGB:
    """Return a copy of the image with the limbs, trunk and head of a person painted in neutral grey.

    Limb by limb rather than the whole box, so that a person who stands close remains visible.
    """
    painted = image_rgb.copy()
    span = np.nanmax(keypoints_px, axis=0) - np.nanmin(keypoints_px, axis=0)
    width = max(3, round(0.14 * float(np.linalg.norm(span))))
    points = [None if np.isnan(point).any() else (round(point[0]), round(point[1])) for point in keypoints_px]
    trunk = [points[i] for i in (5, 6, 12, 11) if points[i] is not None]
    if len(trunk) > 2:
        cv2.fillConvexPoly(painted, cv2.convexHull(np.array(trunk, dtype=np.int32)), _NEUTRAL_GRAY)
    for child, parent in (*BODY_BONES, *_NECK_BONES):
        if points[child] is not None and points[parent] is not None:
            cv2.line(painted, points[child], points[parent], _NEUTRAL_GRAY, width)
    for point in points:
        if point is not None:
            cv2.circle(painted, point, width, _NEUTRAL_GRAY, cv2.FILLED)
    return painted


def fingerprint(options: Mapping[str, Any]) -> dict[str, str]:
    """Return mediapipe's version and the sha256 of the model files in its wheel."""
    version = package_version("mediapipe", _INSTALL)
    folder = package_folder("mediapipe", _INSTALL)  # importing it would cost every run a second
    return {"mediapipe": version} | {file: digest_file(folder / file) for file in _MODEL_FILES}


def _silence() -> None:
    """Make mediapipe as quiet as the environment can, before its C++ library is loaded."""
    os.environ.setdefault("GLOG_minloglevel", "3")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    warnings.filterwarnings("ignore", message="SymbolDatabase.GetPrototype", category=UserWarning)


def _contiguous(image_rgb: ImageRGB | None, camera_id: str, frame: int) -> ImageRGB:
    if image_rgb is None or image_rgb.ndim != 3 or image_rgb.shape[2] != 3 or image_rgb.dtype != np.uint8:
        got = "none" if image_rgb is None else f"{image_rgb.shape} {image_rgb.dtype}"
        raise DetectorError(f"mediapipe needs an RGB image (H, W, 3) uint8 of {camera_id} frame {frame}, got {got}.")
    return np.ascontiguousarray(image_rgb)


def _is_elsewhere(keypoints_px: FloatArray, other_px: FloatArray) -> bool:
    """Tell whether two persons differ by more than a tenth of their extent, in the median over their keypoints."""
    distance = np.linalg.norm(keypoints_px - other_px, axis=-1)
    extent = np.linalg.norm(np.nanmax(other_px, axis=0) - np.nanmin(other_px, axis=0))
    both = np.isfinite(distance)
    return not both.any() or bool(np.median(distance[both]) > 0.1 * extent)
