"""2D body and hand detectors behind one small protocol."""

from assemblyhands_core.detectors.base import (
    BodyDetections,
    BodyDetector,
    DetectorError,
    HandDetection,
    HandDetector,
)
from assemblyhands_core.detectors.registry import (
    DETECTOR_NAMES,
    create_body_detector,
    create_hand_detector,
    fingerprint,
)

__all__ = [
    "DETECTOR_NAMES",
    "BodyDetections",
    "BodyDetector",
    "DetectorError",
    "HandDetection",
    "HandDetector",
    "create_body_detector",
    "create_hand_detector",
    "fingerprint",
]
