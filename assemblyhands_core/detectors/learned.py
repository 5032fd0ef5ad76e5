"""Our own detectors, trained on the studio's pictures (`make train`): a body in a picture, a hand in a crop.

Both work with one network of `models.hand_keypoints`. The hand network is asked twice: for the whole crop, then for
the box around what it found, which is as tight as in training.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.detectors.base import BodyDetections, DetectorError, HandDetection, ImageRGB, masked
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import Hand

if TYPE_CHECKING:
    from assemblyhands_core.models.hand_keypoints import HandKeypointNet

WEIGHTS: Final = Path(__file__).resolve().parents[2] / "weights"
_FIRST_GAMMA: Final = 1.25  # of a stored crop, this share less is looked at first
_SECOND_GAMMA: Final = 1.6
_SURE: Final = 0.3  # joints that are surer decide on the second box
_MIN_SURE: Final = 5


class LearnedBody:
    """The one person in a picture."""

    needs_image = True

    def __init__(self, weights: str | Path | None = None, min_confidence: float = 0.2) -> None:
        """Load the network.

        Args:
            weights: A safetensors file; by default the repository's.
            min_confidence: Keypoints below it are missing.

        Raises:
            DetectorError: The file is absent.
        """
        self._network = _load(_existing(weights, "body_keypoints.safetensors"))
        self._min_confidence = min_confidence

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return the person in a picture, or nobody."""
        if image_rgb is None:
            raise DetectorError("Detector 'learned' looks at pictures: give one.")
        width = self._network.config.image_size_px
        scale = width / image_rgb.shape[1]
        size = (width, round(image_rgb.shape[0] * scale))
        small = cv2.resize(image_rgb, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        pixels, confidence = _estimate(self._network, np.asarray(small, dtype=np.uint8), "right")
        found = np.where(confidence >= self._min_confidence, confidence, 0.0)
        if not found.any():
            return BodyDetections.none()
        keypoints, found = masked((pixels + 0.5) / scale - 0.5, found)
        return BodyDetections(keypoints[None], found[None])


class LearnedHands:
    """The joints of the hand in a crop."""

    needs_image = True

    def __init__(self, weights: str | Path | None = None, min_confidence: float = 0.1) -> None:
        """Load the network.

        Args:
            weights: A safetensors file; by default the repository's.
            min_confidence: Joints below it are missing.

        Raises:
            DetectorError: The file is absent.
        """
        self._network = _load(_existing(weights, "hand_keypoints.safetensors"))
        self._min_confidence = min_confidence

    def detect(
        self,
        image_rgb: ImageRGB | None,
        hand: Hand,
        camera_id: str,
        frame: int,
        expected_px: Float64[np.ndarray, "2"] | None = None,
    ) -> HandDetection | None:
        """Return the joints of the hand in a crop, None if not one is sure enough."""
        if image_rgb is None:
            raise DetectorError("Detector 'learned' looks at crops: give one.")
        height, width = image_rgb.shape[:2]
        center, side = np.array([(width - 1) / 2, (height - 1) / 2]), max(width, height) / _FIRST_GAMMA
        pixels, confidence = self._in_box(image_rgb, hand, center, side)
        sure = confidence >= _SURE
        if sure.sum() >= _MIN_SURE:
            center, side = square_box(pixels[sure], _SECOND_GAMMA)
            pixels, confidence = self._in_box(image_rgb, hand, center, side)
        found = np.where(confidence >= self._min_confidence, confidence, 0.0)
        return HandDetection(*masked(pixels, found)) if found.any() else None

    def _in_box(
        self, image: ImageRGB, hand: Hand, center_px: Float64[np.ndarray, "2"], side_px: float
    ) -> tuple[Float64[np.ndarray, "joint 2"], Float64[np.ndarray, " joint"]]:
        size = self._network.config.image_size_px
        A = window_map(center_px, side_px, size)
        crop = cv2.warpAffine(image, A[:2], (size, size), flags=cv2.INTER_LINEAR)
        pixels, confidence = _estimate(self._network, np.asarray(crop, dtype=np.uint8), hand)
        return (pixels - A[:2, 2]) / A[0, 0], confidence


def fingerprint(options: Mapping[str, Any]) -> dict[str, str]:
    """Return the sha256 of the weights: of the file that is given, or of both that may be read."""
    given = options.get("weights")
    files = [Path(given)] if given else [WEIGHTS / "body_keypoints.safetensors", WEIGHTS / "hand_keypoints.safetensors"]
    return {path.name: digest_file(_existing(path, path.name)) for path in files}


def _existing(weights: str | Path | None, name: str) -> Path:
    path = WEIGHTS / name if weights is None else Path(weights)
    if not path.is_file():
        raise DetectorError(f"Detector 'learned' is to read {path}, which does not exist: `make train` makes weights.")
    return path


def _load(path: Path) -> "HandKeypointNet":
    from assemblyhands_core.models.pretrained import load_hand_keypoints

    return load_hand_keypoints(path)


def _estimate(
    network: "HandKeypointNet", image: UInt8[np.ndarray, "height width 3"], hand: Hand
) -> tuple[Float64[np.ndarray, "keypoint 2"], Float64[np.ndarray, " keypoint"]]:
    """Return keypoints of a picture, and how sure each is."""
    import torch

    with torch.inference_mode():
        pixels = torch.from_numpy(np.ascontiguousarray(image)).movedim(-1, 0)[None].float() / 255.0
        found = network(pixels, torch.tensor([hand == "left"]))
    return found.pixels[0].double().numpy(), found.confidence[0].double().numpy()
