"""Training sets of bodies: whole pictures, shifted, scaled and recoloured anew each time."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float64

from assemblyhands_core.data.arrays import evenly_spread, to_numpy
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS


@dataclass(frozen=True)
class BodyAugmentation:
    """How training pictures differ from the plain ones; zeros switch it off.

    Attributes:
        scale_spread: Standard deviation of the logarithm of the scale.
        shift_spread: Standard deviation of the shift, as a share of the width.
        gain_spread: Standard deviation of the logarithm of the brightness.
    """

    scale_spread: float
    shift_spread: float
    gain_spread: float


@dataclass(frozen=True, eq=False)
class BodyViews:
    """A set of whole pictures with keypoints.

    Attributes:
        images: Encoded pictures, all of one size.
        pixels: True keypoints.
        is_valid: Which count.
        augmentation: What is varied.
        seed: Of everything drawn; with turn and index it decides on a sample.
    """

    images: tuple[bytes, ...]
    pixels: Float64[np.ndarray, "picture keypoint=17 2"]
    is_valid: Bool[np.ndarray, "picture keypoint=17"]
    augmentation: BodyAugmentation
    seed: int

    @staticmethod
    def of(labels: pa.Table, augmentation: BodyAugmentation, seed: int) -> "BodyViews":
        """Take the rows of a `training_tables.BODY_LABELS` table."""
        pixels = to_numpy(labels["body_px"]).reshape(-1, NUM_BODY_KEYPOINTS, 2).astype(np.float64)
        is_valid = to_numpy(labels["valid"]).reshape(-1, NUM_BODY_KEYPOINTS).astype(bool)
        return BodyViews(tuple(labels["image"].to_pylist()), pixels, is_valid, augmentation, seed)

    def spread(self, count: int) -> "BodyViews":
        """Return a set of at most so many pictures, evenly spread."""
        chosen = evenly_spread(len(self), count)
        images = tuple(self.images[index] for index in chosen)
        return replace(self, images=images, pixels=self.pixels[chosen], is_valid=self.is_valid[chosen])

    def __len__(self) -> int:
        """Return how many pictures there are."""
        return len(self.images)

    def sample(self, index: int, turn: int) -> Mapping[str, Any]:
        """Return a picture, uint8 (height, width, 3), the true pixels and which of them lie in it."""
        rng = np.random.default_rng([self.seed, turn, index])
        noise, varied = rng.normal(size=4), self.augmentation
        picture = decode_image(self.images[index])
        height, width = picture.shape[:2]
        side = width * float(np.exp(varied.scale_spread * noise[0]))
        center = np.array([width - 1, height - 1]) / 2 + varied.shift_spread * width * noise[1:3]
        A = window_map(center, side, width)
        A[1, 2] += (height - width) / 2  # windows are square, pictures are not
        image = cv2.warpAffine(picture, A[:2], (width, height), flags=cv2.INTER_LINEAR)
        pixels = self.pixels[index] @ A[:2, :2].T + A[:2, 2]
        inside = ((pixels > -0.5) & (pixels < np.array([width, height]) - 0.5)).all(axis=-1)
        is_valid = self.is_valid[index] & inside
        gained = np.clip(image * float(np.exp(varied.gain_spread * noise[3])), 0, 255).astype(np.uint8)
        return {
            "images": gained,
            "pixels": np.where(is_valid[:, None], pixels, 0.0).astype(np.float32),
            "is_valid": is_valid,
        }
