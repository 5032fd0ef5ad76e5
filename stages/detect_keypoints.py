"""Find the 21 joints of each hand in each view's crop (paper, Sec. 3.1: the 2D half of "2D + Triangulation").

Keypoints are given in the video's own pixels, so that whoever reads them needs no crop. Where no hand is found, the
wrist of the body's skeleton still stands for the hand's wrist, and says so.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from assemblyhands_core.data.camera_rows import camera_from_row, valid_cameras
from assemblyhands_core.data.catalog import BODY_KEYPOINTS, CROPS, KEYPOINTS, VIEWS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.detectors.base import HandDetection, HandDetector
from assemblyhands_core.detectors.registry import create_hand_detector
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import source_pixels
from assemblyhands_core.hands.body import ARMS
from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST
from stages._contract import Context, Stage, Tables
from stages._detector_config import DetectorConfig, detector_externals

Floats = npt.NDArray[np.float64]
Row = Mapping[str, Any]
Wrists = Mapping[tuple[int, str, str], tuple[Floats, float]]  # (frame, camera, hand) → pixel (2,), confidence
_BODY = "body"


class DetectKeypointsConfig(DetectorConfig):
    """Parameters of keypoint detection."""

    keypoints_file = "hands.parquet"
    wrist_from_body: bool


def run(config: DetectKeypointsConfig, inputs: Tables, context: Context) -> Tables:
    """Detect the joints of one chunk; one row for each crop, also for those that were not cut."""
    cameras = valid_cameras(inputs["views"])
    detector = create_hand_detector(config.detector, **config.detector_options(context.sequence_id))
    wrists = _body_wrists(inputs["body_keypoints"].to_pylist())
    rows = [_row(config, detector, crop, cameras, wrists) for crop in inputs["crops"].to_pylist()]
    return {"keypoints": KEYPOINTS.from_rows(rows)}


def _row(
    config: DetectKeypointsConfig, detector: HandDetector, crop: Row, cameras: Mapping[str, Camera], wrists: Wrists
) -> dict[str, Any]:
    """Return a crop's row: the hand detector's joints, else the body's wrist alone, else the reason why nothing."""
    camera = cameras.get(crop["camera_id"])
    wrist = wrists.get((crop["frame"], crop["camera_id"], crop["hand"]))
    found, source = None, ""
    if camera is not None and (crop["valid"] or not detector.needs_image):
        found, source = _detect(detector, crop, camera, wrist), config.detector
    if found is None and wrist is not None and config.wrist_from_body:
        found, source = _wrist_only(*wrist), _BODY
    hole = HandDetection(np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS))
    return {
        **{name: crop[name] for name in KEYPOINTS.key},
        "keypoints_px": (found or hole).keypoints_px.ravel(),
        "confidence": (found or hole).confidence,
        "source": source if found else "",
        "valid": found is not None,
        "reason": "" if found else crop["reason"] or "no_detection",
    }


def _detect(
    detector: HandDetector, crop: Row, camera: Camera, wrist: tuple[Floats, float] | None
) -> HandDetection | None:
    """Return the hand's joints in the video's pixels."""
    name = crop["hand"], crop["camera_id"], crop["frame"]
    if not detector.needs_image:
        return detector.detect(None, *name, expected_px=_expected_px(crop, camera, wrist))
    found = detector.detect(decode_image(crop["image"]), *name)
    if found is None:
        return None
    in_video_px = np.asarray(source_pixels(camera, camera_from_row(crop), found.keypoints_px), dtype=np.float64)
    is_seen = np.isfinite(in_video_px).all(axis=1) & (found.confidence > 0)
    return HandDetection(in_video_px, np.where(is_seen, found.confidence, 0.0)) if is_seen.any() else None


def _expected_px(crop: Row, camera: Camera, wrist: tuple[Floats, float] | None) -> Floats | None:
    """Return where (2,) in the video the followed person's hand should be, None where nothing tells."""
    if not crop["valid"]:
        return None if wrist is None else wrist[0]
    middle_px = np.array([crop["width_px"] - 1.0, crop["height_px"] - 1.0]) / 2
    expected_px = np.asarray(source_pixels(camera, camera_from_row(crop), middle_px), dtype=np.float64)
    return expected_px if np.isfinite(expected_px).all() else None


def _body_wrists(body_keypoints: list[dict[str, Any]]) -> Wrists:
    """Return where the body detector saw wrists."""
    wrists: dict[tuple[int, str, str], tuple[Floats, float]] = {}
    for row in body_keypoints:
        for hand, arm in ARMS.items():
            pixel = np.array(row["body_px"][2 * arm.wrist : 2 * arm.wrist + 2], dtype=np.float64)
            if row["confidence"][arm.wrist] > 0 and np.isfinite(pixel).all():
                wrists[row["frame"], row["camera_id"], hand] = (pixel, row["confidence"][arm.wrist])
    return wrists


def _wrist_only(pixel: Floats, confidence: float) -> HandDetection:
    keypoints_px, weights = np.full((NUM_JOINTS, 2), np.nan), np.zeros(NUM_JOINTS)
    keypoints_px[WRIST], weights[WRIST] = pixel, confidence
    return HandDetection(keypoints_px, weights)


STAGE = Stage(
    name="detect_keypoints",
    version=1,
    config=DetectKeypointsConfig,
    inputs={"views": VIEWS, "crops": CROPS, "body_keypoints": BODY_KEYPOINTS},
    outputs={"keypoints": KEYPOINTS},
    run=run,
    shard="chunk",
    externals=detector_externals,
)
