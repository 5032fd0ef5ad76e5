"""Our own detectors, trained on the studio's pictures (`make train`): a body in a picture, a hand in a crop.

Both work with one network of `models.hand_keypoints`. The hand network is asked twice: for the whole crop, then for
the box around what it found, which is as tight as in training.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.detectors.base import (
    BodyDetections,
    DetectorError,
    HandCrop,
    HandDetection,
    ImageRGB,
    masked,
)
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS, Hand

if TYPE_CHECKING:
    from assemblyhands_core.models.hand_keypoints import HandKeypointNet

WEIGHTS: Final = Path(__file__).resolve().parents[2] / "weights"
_FIRST_GAMMA: Final = 1.25  # of a stored crop, this share less is looked at first
_SECOND_GAMMA: Final = 1.6
_SURE: Final = 0.3  # joints that are surer decide on the second box
_MIN_SURE: Final = 5
_BATCH: Final = 16  # crops at a time

AnyImage = UInt8[np.ndarray, "_ _ 3"]  # among others of other sizes
Box = tuple[Float64[np.ndarray, "2"], float]  # centre and side


class LearnedBody:
    """The one person in a picture."""

    needs_image = True

    def __init__(self, weights: str | Path | None = None, min_confidence: float = 0.2) -> None:
        """Load the network.

        Args:
            weights: A safetensors file; by default the repository's.
            min_confidence: Keypoints below it are missing.

        Raises:
            DetectorError: The file is absent, or of another network.
        """
        self._network = _load(_existing(weights, "body_keypoints.safetensors"), NUM_BODY_KEYPOINTS)
        self._min_confidence = min_confidence

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return the person in a picture, or nobody."""
        if image_rgb is None:
            raise DetectorError("Detector 'learned' looks at pictures: give one.")
        width = self._network.config.image_size_px
        scale = width / image_rgb.shape[1]
        size = (width, round(image_rgb.shape[0] * scale))
        small = cv2.resize(image_rgb, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        ((pixels,), (confidence,)) = _estimate(self._network, np.asarray(small, dtype=np.uint8)[None], ["right"])
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
            DetectorError: The file is absent, or of another network.
        """
        self._network = _load(_existing(weights, "hand_keypoints.safetensors"), NUM_JOINTS)
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
        return self.detect_many([HandCrop(image_rgb, hand, camera_id, frame, expected_px)])[0]

    def detect_many(self, crops: Sequence[HandCrop]) -> list[HandDetection | None]:
        """Return the joints of the hand in each crop, None where not one is sure enough."""
        images = [crop.image_rgb for crop in crops if crop.image_rgb is not None]
        if len(images) < len(crops):
            raise DetectorError("Detector 'learned' looks at crops: give one.")
        hands, found = [crop.hand for crop in crops], []
        for first in range(0, len(crops), _BATCH):
            part = slice(first, first + _BATCH)
            found += self._in_crops(images[part], hands[part])
        return found

    def _in_crops(self, images: Sequence[AnyImage], hands: Sequence[Hand]) -> list[HandDetection | None]:
        boxes = [_middle_box(image) for image in images]
        pixels, confidence = self._in_boxes(images, hands, boxes)
        again = np.flatnonzero((confidence >= _SURE).sum(axis=1) >= _MIN_SURE).tolist()
        if again:
            tight = [square_box(pixels[i][confidence[i] >= _SURE], _SECOND_GAMMA) for i in again]
            closer = self._in_boxes([images[i] for i in again], [hands[i] for i in again], tight)
            pixels[again], confidence[again] = closer
        confidence[confidence < self._min_confidence] = 0.0
        return [
            HandDetection(*masked(*pair)) if pair[1].any() else None for pair in zip(pixels, confidence, strict=True)
        ]

    def _in_boxes(
        self, images: Sequence[AnyImage], hands: Sequence[Hand], boxes: Sequence[Box]
    ) -> tuple[Float64[np.ndarray, "crop joint 2"], Float64[np.ndarray, "crop joint"]]:
        """Return joints in the crops' pixels, seen through a box in each."""
        size = self._network.config.image_size_px
        maps = np.stack([window_map(center, side, size) for center, side in boxes])
        windows = [
            cv2.warpAffine(image, A[:2], (size, size), flags=cv2.INTER_LINEAR)
            for image, A in zip(images, maps, strict=True)
        ]
        pixels, confidence = _estimate(self._network, np.asarray(np.stack(windows), dtype=np.uint8), hands)
        return (pixels - maps[:, None, :2, 2]) / maps[:, None, :1, 0], confidence


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


def _load(path: Path, num_joints: int) -> "HandKeypointNet":
    import torch

    from assemblyhands_core.models.pretrained import load_hand_keypoints
    from assemblyhands_core.models.warm import load_once

    torch.set_num_threads(1)  # the same bits on every machine, however many cores a worker has
    network = load_once(load_hand_keypoints, path)
    if network.config.num_joints != num_joints:
        found = network.config.num_joints
        raise DetectorError(f"{path} finds {found} joints, {num_joints} are wanted: give the other network's weights.")
    return network


def _middle_box(image: ImageRGB) -> Box:
    """Return centre and side of the box of a crop that is looked at first."""
    height, width = image.shape[:2]
    return np.array([(width - 1) / 2, (height - 1) / 2]), max(width, height) / _FIRST_GAMMA


def _estimate(
    network: "HandKeypointNet", images: UInt8[np.ndarray, "image height width 3"], hands: Sequence[Hand]
) -> tuple[Float64[np.ndarray, "image keypoint 2"], Float64[np.ndarray, "image keypoint"]]:
    """Return keypoints of pictures, and how sure each is."""
    import torch

    with torch.inference_mode():
        pixels = torch.from_numpy(np.ascontiguousarray(images)).movedim(-1, 1).float() / 255.0
        found = network(pixels, torch.tensor([hand == "left" for hand in hands]))
    return found.pixels.double().numpy(), found.confidence.double().numpy()
