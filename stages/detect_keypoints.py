"""Find the 21 joints of each hand in each view's crop (paper, Sec. 3.1: the 2D half of "2D + Triangulation").

Keypoints are given in the video's own pixels, so that whoever reads them needs no crop. Where no hand is found, the
wrist of the body's skeleton still stands for the hand's wrist, and says so.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import JsonValue

from assemblyhands_core.data.camera_rows import camera_from_row, valid_cameras
from assemblyhands_core.data.catalog import BODY_KEYPOINTS, CROPS, KEYPOINTS, VIEWS
from assemblyhands_core.detectors.base import HandDetection, HandDetector
from assemblyhands_core.detectors.options import detector_options
from assemblyhands_core.detectors.registry import create_hand_detector, fingerprint
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import source_pixels
from assemblyhands_core.hands.body import ARMS
from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST
from stages._contract import Context, Stage, StageConfig, Tables

Floats = npt.NDArray[np.float64]
_BODY = "body"


class DetectKeypointsConfig(StageConfig):
    """Parameters of keypoint detection."""

    detector: str
    options: Mapping[str, Mapping[str, JsonValue]]
    wrist_from_body: bool


def run(config: DetectKeypointsConfig, inputs: Tables, context: Context) -> Tables:
    """Detect the joints in all crops of one chunk."""
    cameras = valid_cameras(inputs["views"])
    detector = create_hand_detector(config.detector, **_options(config, context.sequence_id))
    wrists = _body_wrists(inputs) if config.wrist_from_body else {}
    rows = [_row(config, detector, crop, cameras, wrists) for crop in inputs["crops"].to_pylist()]
    return {"keypoints": KEYPOINTS.from_rows(rows)}


def _row(
    config: DetectKeypointsConfig,
    detector: HandDetector,
    crop: Mapping[str, Any],
    cameras: Mapping[str, Camera],
    wrists: Mapping[tuple[int, str, str], tuple[Floats, float]],
) -> dict[str, Any]:
    """Return a crop's row: the hand detector's joints, else the body's wrist alone, else the reason why nothing."""
    found, source, reason = None, "", crop["reason"]
    if crop["valid"]:
        found = _detect(detector, crop, cameras[crop["camera_id"]])
        source, reason = config.detector, ""
    if found is None and (wrist := wrists.get((crop["frame"], crop["camera_id"], crop["hand"]))):
        found, source, reason = _wrist_only(*wrist), _BODY, ""
    if found is None:
        source, reason = "", reason or "no_detection"
        found = HandDetection(np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS))
    names = ("sequence_id", "frame", "hand", "camera_id")
    return {
        **{name: crop[name] for name in names},
        "keypoints_px": found.keypoints_px.ravel(),
        "confidence": found.confidence,
        "source": source,
        "valid": reason == "",
        "reason": reason,
    }


def _detect(detector: HandDetector, crop: Mapping[str, Any], camera: Camera) -> HandDetection | None:
    """Return the hand's joints in the video's pixels."""
    if not detector.needs_image:
        return detector.detect(None, crop["hand"], crop["camera_id"], crop["frame"])
    image = cv2.imdecode(np.frombuffer(crop["image"], np.uint8), cv2.IMREAD_COLOR_RGB)
    found = detector.detect(image, crop["hand"], crop["camera_id"], crop["frame"])
    if found is None:
        return None
    in_video_px = np.asarray(source_pixels(camera, camera_from_row(crop), found.keypoints_px), dtype=np.float64)
    is_seen = np.isfinite(in_video_px).all(axis=1)
    return HandDetection(in_video_px, np.where(is_seen, found.confidence, 0.0))


def _body_wrists(inputs: Tables) -> dict[tuple[int, str, str], tuple[Floats, float]]:
    """Return the body detector's wrists: (frame, camera, hand) → pixel (2,) and confidence."""
    wrists: dict[tuple[int, str, str], tuple[Floats, float]] = {}
    for row in inputs["body_keypoints"].to_pylist():
        for hand, arm in ARMS.items():
            pixel = np.array(row["body_px"][2 * arm.wrist : 2 * arm.wrist + 2], dtype=np.float64)
            if row["confidence"][arm.wrist] > 0 and np.isfinite(pixel).all():
                wrists[row["frame"], row["camera_id"], hand] = (pixel, row["confidence"][arm.wrist])
    return wrists


def _wrist_only(pixel: Floats, confidence: float) -> HandDetection:
    keypoints_px, weights = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    keypoints_px[WRIST], weights[WRIST] = pixel, confidence
    return HandDetection(keypoints_px, weights)


def _options(config: DetectKeypointsConfig, sequence_id: str) -> dict[str, Any]:
    return detector_options(config.options, config.detector, sequence_id)


def _externals(config: DetectKeypointsConfig, sequence_id: str) -> Mapping[str, str]:
    return fingerprint(config.detector, _options(config, sequence_id))


STAGE = Stage(
    name="detect_keypoints",
    version=1,
    config=DetectKeypointsConfig,
    inputs={"views": VIEWS, "crops": CROPS, "body_keypoints": BODY_KEYPOINTS},
    outputs={"keypoints": KEYPOINTS},
    run=run,
    shard="chunk",
    externals=_externals,
)
