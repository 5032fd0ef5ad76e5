"""Training sets of egocentric crops: one hand a sample, both hands' joints where they are labelled."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float64, Int64

from assemblyhands_core.data.arrays import evenly_spread, to_numpy
from assemblyhands_core.data.crop_images import ImageBytes, decode_image
from assemblyhands_core.data.ego_boxes import IDENTITIES
from assemblyhands_core.data.hand_crops import window_map
from assemblyhands_core.hands.joints import HANDS, NUM_BOTH, NUM_JOINTS, WRIST

_OTHER_HAND: Final = np.r_[NUM_JOINTS:NUM_BOTH, :NUM_JOINTS]
_MIRRORED_IDENTITY: Final = np.array([1, 0, 2])


@dataclass(frozen=True)
class EgoAugmentation:
    """How training crops differ from the plain ones; zeros switch it off.

    Attributes:
        scale_spread: Standard deviation of the logarithm of the window's side.
        shift_spread: Standard deviation of the window's centre, as a share of its side.
        turn_deg: Largest turn in the picture's plane, to either side.
        flip_share: Share of samples that are mirrored, with the hands' names exchanged.
        gain_spread: Standard deviation of the logarithm of the brightness.
        noise_spread: Standard deviation of the noise of single pixels, of 255.
    """

    scale_spread: float
    shift_spread: float
    turn_deg: float
    flip_share: float
    gain_spread: float
    noise_spread: float


PLAIN: Final = EgoAugmentation(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class EgoCrops:
    """A set of egocentric crops, right hand's joints first.

    Attributes:
        images: Encoded pictures, still inside their table.
        intrinsics_px: fx, fy, cx, cy of each crop.
        joints_camera_mm: NaN where not labelled.
        is_labelled: Known and in the crop.
        hand: Which one the crop is of, index into `HANDS`.
        identity: What it shows, index into `IDENTITIES`.
        augmentation: What is varied.
        size_px: Side of the pictures that the network sees.
        seed: Of everything drawn; with turn and index it decides on a sample.
    """

    images: tuple[ImageBytes, ...]
    intrinsics_px: Float64[np.ndarray, "crop 4"]
    joints_camera_mm: Float64[np.ndarray, "crop joint=42 3"]
    is_labelled: Bool[np.ndarray, "crop joint=42"]
    hand: Int64[np.ndarray, " crop"]
    identity: Int64[np.ndarray, " crop"]
    augmentation: EgoAugmentation
    size_px: int
    seed: int

    @staticmethod
    def of(crops: pa.Table, augmentation: EgoAugmentation, size_px: int, seed: int) -> "EgoCrops":
        """Take the rows of a `ego_tables.EGO_CROPS` table that are valid and know the wrist of their hand.

        Joints of a hand whose wrist is unknown have no depth relative to it: they do not count.
        """
        joints = to_numpy(crops["joints_camera_mm"]).reshape(-1, NUM_BOTH, 3).astype(np.float64)
        is_labelled = to_numpy(crops["is_labelled"]).reshape(-1, NUM_BOTH).astype(bool)
        has_wrist = np.asarray(np.isfinite(joints[:, [WRIST, NUM_JOINTS + WRIST]]).all(axis=-1))
        is_labelled = is_labelled & np.repeat(has_wrist, NUM_JOINTS, axis=1)
        hand = np.array([HANDS.index(name) for name in crops["hand"].to_pylist()], dtype=np.int64)
        rows = np.flatnonzero(to_numpy(crops["valid"]).astype(bool) & has_wrist[np.arange(len(hand)), hand])
        pictures = [scalar.as_buffer() for chunk in crops["image"].chunks for scalar in chunk]
        names = crops["identity"].to_pylist()
        return EgoCrops(
            images=tuple(pictures[row] for row in rows),
            intrinsics_px=to_numpy(crops["intrinsics_px"]).astype(np.float64)[rows],
            joints_camera_mm=joints[rows],
            is_labelled=is_labelled[rows],
            hand=hand[rows],
            identity=np.array([IDENTITIES.index(names[row]) for row in rows], dtype=np.int64),
            augmentation=augmentation,
            size_px=size_px,
            seed=seed,
        )

    def spread(self, count: int) -> "EgoCrops":
        """Return a set of at most so many crops, evenly spread."""
        chosen = evenly_spread(len(self), count)
        names = ("intrinsics_px", "joints_camera_mm", "is_labelled", "hand", "identity")
        columns = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, images=tuple(self.images[index] for index in chosen), **columns)

    def __len__(self) -> int:
        """Return how many crops there are."""
        return len(self.images)

    def sample(self, index: int, turn: int) -> Mapping[str, Any]:
        """Return a sample's arrays by name.

        Returns:
            ``images`` (size, size, 3) uint8; ``pixels`` (42, 2) in it; ``depth_mm`` (42,) beyond each joint's wrist;
            ``is_valid`` (42,); ``is_own`` (42,), those of the crop's hand; ``identity``; ``joints_camera_mm`` (42, 3);
            ``ray_from_pixel`` (3, 3), K⁻¹ of the picture; ``wrist_depth_mm`` (42,), of each joint's wrist.
        """
        rng = np.random.default_rng([self.seed, turn, index])
        picture = decode_image(self.images[index])
        is_flipped = bool(rng.random() < self.augmentation.flip_share)
        A = self._window(picture.shape[1], picture.shape[0], is_flipped, rng)
        image = cv2.warpAffine(picture, A[:2], (self.size_px, self.size_px), flags=cv2.INTER_LINEAR)
        joints, is_labelled, own = self.joints_camera_mm[index], self.is_labelled[index], int(self.hand[index])
        identity, ray_from_pixel = int(self.identity[index]), np.linalg.inv(A @ _K(self.intrinsics_px[index]))
        if is_flipped:  # the mirror image of a left hand is a right one, in a world whose x is turned round
            joints, is_labelled = joints[_OTHER_HAND] * [-1.0, 1.0, 1.0], is_labelled[_OTHER_HAND]
            own, identity = 1 - own, int(_MIRRORED_IDENTITY[identity])
            ray_from_pixel = np.diag([-1.0, 1.0, 1.0]) @ ray_from_pixel
        pixels = _projected(np.linalg.inv(ray_from_pixel), joints)
        is_inside = ((pixels > -0.5) & (pixels < self.size_px - 0.5)).all(axis=-1)
        wrist_depth_mm = np.repeat(joints[[WRIST, NUM_JOINTS + WRIST], 2], NUM_JOINTS)
        return {
            "images": self._recoloured(np.asarray(image, dtype=np.uint8), rng),
            "pixels": np.nan_to_num(pixels).astype(np.float32),
            "depth_mm": np.nan_to_num(joints[:, 2] - wrist_depth_mm).astype(np.float32),
            "is_valid": is_labelled & is_inside,
            "is_own": np.arange(NUM_BOTH) // NUM_JOINTS == own,
            "identity": identity,
            "joints_camera_mm": np.nan_to_num(joints).astype(np.float32),
            "ray_from_pixel": ray_from_pixel.astype(np.float32),
            "wrist_depth_mm": np.nan_to_num(wrist_depth_mm).astype(np.float32),
        }

    def _window(
        self, width_px: int, height_px: int, is_flipped: bool, rng: np.random.Generator
    ) -> Float64[np.ndarray, "3 3"]:
        """Return the map from a stored crop to the network's picture."""
        varied, noise = self.augmentation, rng.normal(size=3)
        side = max(width_px, height_px) * float(np.exp(varied.scale_spread * noise[0]))
        center = np.array([width_px - 1, height_px - 1]) / 2 + varied.shift_spread * side * noise[1:]
        turn = np.deg2rad(varied.turn_deg) * float(rng.uniform(-1.0, 1.0))
        A = window_map(center, side, self.size_px, turn)
        mirror = np.array([[-1.0, 0.0, self.size_px - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(mirror @ A if is_flipped else A)

    def _recoloured(self, image: Any, rng: np.random.Generator) -> Any:
        gain = float(np.exp(self.augmentation.gain_spread * rng.normal()))
        noise = 255.0 * self.augmentation.noise_spread * rng.normal(size=(*image.shape[:2], 1))
        return np.clip(image * gain + noise, 0, 255).astype(np.uint8)


def _K(intrinsics_px: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3 3"]:
    fx, fy, cx, cy = intrinsics_px
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _projected(
    pixel_from_ray: Float64[np.ndarray, "3 3"], joints_mm: Float64[np.ndarray, "joint 3"]
) -> Float64[np.ndarray, "joint 2"]:
    """Return pixels, NaN for joints that are unknown or not before the camera."""
    is_ahead = np.isfinite(joints_mm).all(axis=-1) & (np.nan_to_num(joints_mm[:, 2]) > 0)
    found = np.where(is_ahead[:, None], joints_mm, 1.0) @ pixel_from_ray.T
    return np.where(is_ahead[:, None], found[:, :2] / found[:, 2:], np.nan)
