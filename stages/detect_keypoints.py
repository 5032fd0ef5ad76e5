"""Find the 21 joints of each hand in each view's crop (paper, Sec. 3.1: the 2D half of "2D + Triangulation").

Keypoints are given in the video's own pixels, so that whoever reads them needs no crop. Where no hand is found, the
wrist of the body's skeleton still stands for the hand's wrist, and says so.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from assemblyhands_core.data.camera_rows import camera_from_row, valid_cameras
from assemblyhands_core.data.catalog import BODY_KEYPOINTS, CROPS, KEYPOINTS, VIEWS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.detectors.base import HandCrop, HandDetection, HandDetector, detect_hands_in
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
_AT_ONCE = 64  # crops that are decoded at a time


class DetectKeypointsConfig(DetectorConfig):
    """Parameters of keypoint detection."""

    keypoints_file = "hands.parquet"
    wrist_from_body: bool


def run(config: DetectKeypointsConfig, inputs: Tables, context: Context) -> Tables:
    """Detect the joints of one chunk; one row for each crop, also for those that were not cut."""
    cameras = valid_cameras(inputs["views"])
    detector = create_hand_detector(config.detector, **config.detector_options(context.sequence_id))
    wrists = _body_wrists(inputs["body_keypoints"].to_pylist())
    crops = inputs["crops"].to_pylist()
    parts = [crops[first : first + _AT_ONCE] for first in range(0, len(crops), _AT_ONCE)]
    found = [hand for part in parts for hand in _detected(detector, part, cameras, wrists)]
    rows = [_row(config, crop, hand, wrists) for crop, hand in zip(crops, found, strict=True)]
    return {"keypoints": KEYPOINTS.from_rows(rows)}


def _row(config: DetectKeypointsConfig, crop: Row, found: HandDetection | None, wrists: Wrists) -> dict[str, Any]:
    """Return a crop's row: the hand detector's joints, else the body's wrist alone, else the reason why nothing."""
    wrist, source = wrists.get(_hand_in_view(crop)), config.detector
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


def _hand_in_view(crop: Row) -> tuple[int, str, str]:
    return crop["frame"], crop["camera_id"], crop["hand"]


def _detected(
    detector: HandDetector, crops: Sequence[Row], cameras: Mapping[str, Camera], wrists: Wrists
) -> list[HandDetection | None]:
    """Return the joints of each crop's hand in the video's pixels, None where it is not found or not looked for."""
    found: list[HandDetection | None] = [None] * len(crops)
    places = [i for i, crop in enumerate(crops) if crop["camera_id"] in cameras]
    places = [i for i in places if crops[i]["valid"] or not detector.needs_image]
    asked = [_asked(detector, crops[i], cameras, wrists) for i in places]
    for i, hand in zip(places, detect_hands_in(detector, asked), strict=True):
        if hand is not None and detector.needs_image:
            hand = _in_video(hand, crops[i], cameras[crops[i]["camera_id"]])
        found[i] = hand
    return found


def _asked(detector: HandDetector, crop: Row, cameras: Mapping[str, Camera], wrists: Wrists) -> HandCrop:
    name = crop["hand"], crop["camera_id"], crop["frame"]
    if detector.needs_image:
        return HandCrop(decode_image(crop["image"]), *name)
    return HandCrop(None, *name, _expected_px(crop, cameras[crop["camera_id"]], wrists.get(_hand_in_view(crop))))


def _in_video(found: HandDetection, crop: Row, camera: Camera) -> HandDetection | None:
    """Return joints in the video's pixels that were found in a crop's."""
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
