"""What a 2D detector is: one small protocol for bodies, one for hands, and what they return.

Detectors are stateless: the result for an image depends on that image and the options alone, so that neither the order
of the frames nor the number of workers can change it. Missing keypoints are NaN with confidence 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from jaxtyping import Float64, Real, UInt8

from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES, NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST_FIRST_ORDER, Hand

FloatArray = npt.NDArray[np.float64]
ImageRGB = UInt8[np.ndarray, "height width 3"]

_OTHER_SIDE: Final = {"left": "right", "right": "left"}
# Each body keypoint's counterpart of the other side: what is left to exchange where a detector took a back for a front.
BODY_MIRROR: Final = tuple(
    BODY_KEYPOINT_NAMES.index("_".join(_OTHER_SIDE.get(part, part) for part in name.split("_")))
    for name in BODY_KEYPOINT_NAMES
)


class DetectorError(ValueError):
    """A detector cannot be made or cannot read its input; the message says what to do."""


@dataclass(frozen=True, eq=False)
class BodyDetections:
    """The persons found in one image.

    Attributes:
        keypoints_px: COCO-17 order, raw pixels of the image; NaN = missing.
        confidence: In 0..1; 0 = missing.
    """

    keypoints_px: Float64[np.ndarray, "detection keypoint=17 2"]
    confidence: Float64[np.ndarray, "detection keypoint=17"]

    def __post_init__(self) -> None:
        _check_shapes(self.keypoints_px, self.confidence, (len(self.keypoints_px), NUM_BODY_KEYPOINTS))

    @classmethod
    def none(cls) -> "BodyDetections":
        """Return the detections of an image without persons."""
        return cls(np.empty((0, NUM_BODY_KEYPOINTS, 2)), np.empty((0, NUM_BODY_KEYPOINTS)))


@dataclass(frozen=True, eq=False)
class HandDetection:
    """The joints of one hand in one image.

    Attributes:
        keypoints_px: AssemblyHands order (tip→base, wrist last), pixels of the image; NaN = missing.
        confidence: In 0..1; 0 = missing.
    """

    keypoints_px: Float64[np.ndarray, "joint=21 2"]
    confidence: Float64[np.ndarray, "joint=21"]

    def __post_init__(self) -> None:
        _check_shapes(self.keypoints_px, self.confidence, (NUM_JOINTS,))


@runtime_checkable
class BodyDetector(Protocol):
    """Finds the persons in an image."""

    needs_image: bool

    def detect(self, image_rgb: ImageRGB | None, camera_id: str, frame: int) -> BodyDetections:
        """Return the persons of one camera's image; None only where ``needs_image`` is False."""
        ...


@runtime_checkable
class HandDetector(Protocol):
    """Finds one given hand in an image of it."""

    needs_image: bool

    def detect(
        self,
        image_rgb: ImageRGB | None,
        hand: Hand,
        camera_id: str,
        frame: int,
        expected_px: Float64[np.ndarray, "2"] | None = None,
    ) -> HandDetection | None:
        """Return the hand, or None where it is not found.

        Args:
            image_rgb: a crop around the hand; None only where ``needs_image`` is False.
            hand: which hand to look for.
            camera_id: the camera that saw it.
            frame: frame number in the sequence.
            expected_px: where the hand should be; chooses among several. Default: the middle of the crop.

        Returns:
            The joints in pixels of ``image_rgb``; where ``needs_image`` is False in raw pixels of the camera's image.
        """
        ...


@dataclass(frozen=True, eq=False)
class HandCrop:
    """What a hand detector is asked about, see `HandDetector.detect`."""

    image_rgb: ImageRGB | None
    hand: Hand
    camera_id: str
    frame: int
    expected_px: Float64[np.ndarray, "2"] | None = None


@runtime_checkable
class BatchedHandDetector(HandDetector, Protocol):
    """A hand detector that is faster on many crops at once than on one after the other."""

    def detect_many(self, crops: Sequence[HandCrop]) -> list[HandDetection | None]:
        """Return for each crop what `detect` would."""
        ...


def detect_hands_in(detector: HandDetector, crops: Sequence[HandCrop]) -> list[HandDetection | None]:
    """Return the hand of each crop, None where it is not found; all at once where the detector can do that."""
    if isinstance(detector, BatchedHandDetector):
        return detector.detect_many(crops)
    return [detector.detect(c.image_rgb, c.hand, c.camera_id, c.frame, expected_px=c.expected_px) for c in crops]


def from_wrist_first(values: Real[np.ndarray, "joint=21 *rest"]) -> Float64[np.ndarray, "joint=21 *rest"]:
    """Return values of OpenPose's and MediaPipe's joint order in ours (tip→base, wrist last)."""
    source = np.asarray(values, dtype=np.float64)
    ordered = np.empty_like(source)
    ordered[list(WRIST_FIRST_ORDER)] = source
    return ordered


def masked(
    keypoints_px: Float64[np.ndarray, "*batch 2"], confidence: Float64[np.ndarray, "*batch"]
) -> tuple[Float64[np.ndarray, "*batch 2"], Float64[np.ndarray, "*batch"]]:
    """Return both arrays with every keypoint that lacks a confidence or a finite place set to NaN and 0.

    Args:
        keypoints_px: pixels.
        confidence: 0 or NaN = missing; values above 1 (heat-map peaks of some detectors) are set to 1.
    """
    found = np.isfinite(keypoints_px).all(axis=-1) & (confidence > 0)
    return np.where(found[..., None], keypoints_px, np.nan), np.where(found, np.minimum(confidence, 1.0), 0.0)


def _check_shapes(keypoints_px: Any, confidence: Any, expected: tuple[int, ...]) -> None:
    if keypoints_px.shape != (*expected, 2) or confidence.shape != expected:
        raise DetectorError(
            f"keypoints {keypoints_px.shape} and confidence {confidence.shape} must have the shapes "
            f"{(*expected, 2)} and {expected}"
        )
