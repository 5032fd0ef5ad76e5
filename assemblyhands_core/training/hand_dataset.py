"""Training sets of hands: every epoch sees each hand through other boxes, views and colours.

Source: paper, supplement B (box expansion γ of mean 1.5, root noise of ±5 mm on every axis); the rest is ours, and each
part can be switched off.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Float32, Float64, UInt8

from assemblyhands_core.data.hand_crops import HandLabel, StoredHand, cut, hand_labels, stored_hands, window_map
from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import ROOT


@dataclass(frozen=True)
class Augmentation:
    """How training crops differ from the plain ones; everything at its neutral value switches it off.

    Attributes:
        gamma: Mean expansion of the box around the joints (paper: 1.5).
        gamma_spread: Standard deviation of ln gamma.
        center_spread: Standard deviation of the box's centre, as a share of its side.
        turn_deg: Largest turn of a crop in its plane, to either side.
        root_mm: Largest error of the root along each axis (paper: 5 mm).
        min_views, max_views: How many views are drawn, at random; all of them if there are fewer.
        gain_spread: Standard deviation of the logarithm of each colour's gain.
        brightness_spread: Standard deviation of what is added to all colours, of 255.
    """

    gamma: float
    gamma_spread: float
    center_spread: float
    turn_deg: float
    root_mm: float
    min_views: int
    max_views: int
    gain_spread: float
    brightness_spread: float


@dataclass(frozen=True, eq=False)
class HandSample:
    """One hand as training sees it; views beyond those drawn are black and not used."""

    images: UInt8[np.ndarray, "view size size 3"]
    P_pixel_from_world: Float32[np.ndarray, "view 3 4"]
    is_view_used: Bool[np.ndarray, " view"]
    root_world_mm: Float32[np.ndarray, "3"]
    joints_world_mm: Float32[np.ndarray, "joint=21 3"]
    is_valid: Bool[np.ndarray, "joint=21"]
    is_left: bool


def draw_sample(
    hand: StoredHand,
    label: HandLabel,
    augmentation: Augmentation,
    size_px: int,
    rng: np.random.Generator,
) -> HandSample:
    """Cut a training sample.

    Args:
        hand: Its stored crops.
        label: Its joints; the root has to be among the valid ones.
        augmentation: What is varied.
        size_px: Side of the crops.
        rng: Decides on everything.
    """
    num_views = int(rng.integers(augmentation.min_views, augmentation.max_views + 1))
    order = rng.permutation(len(hand.views))
    num_slots = augmentation.max_views
    images = np.zeros((num_slots, size_px, size_px, 3), dtype=np.uint8)
    matrices = np.zeros((num_slots, 3, 4))
    is_used = np.zeros(num_slots, dtype=bool)
    known = label.joints_world_mm[label.is_valid]
    for slot, index in enumerate(order[:num_views].tolist()):
        view = hand.views[index]
        piece = cut(view, _drawn_window(view.project(known), augmentation, size_px, rng), size_px)
        images[slot] = _recoloured(piece.image, augmentation, rng)
        matrices[slot], is_used[slot] = piece.P_pixel_from_world, True
    noise = rng.uniform(-augmentation.root_mm, augmentation.root_mm, 3)
    return HandSample(
        images=images,
        P_pixel_from_world=matrices.astype(np.float32),
        is_view_used=is_used,
        root_world_mm=(label.joints_world_mm[ROOT] + noise).astype(np.float32),
        joints_world_mm=np.nan_to_num(label.joints_world_mm).astype(np.float32),
        is_valid=label.is_valid,
        is_left=hand.is_left,
    )


def _drawn_window(
    joints_px: Float[np.ndarray, "point 2"], augmentation: Augmentation, size_px: int, rng: np.random.Generator
) -> Float64[np.ndarray, "3 3"]:
    center, side = square_box(joints_px[np.isfinite(joints_px).all(axis=-1)], 1.0)
    noise = rng.normal(size=3)
    side *= augmentation.gamma * float(np.exp(augmentation.gamma_spread * noise[0]))
    center = center + augmentation.center_spread * side * noise[1:]
    turn = np.deg2rad(augmentation.turn_deg) * float(rng.uniform(-1.0, 1.0))
    return window_map(center, side, size_px, turn)


def _recoloured(
    image: UInt8[np.ndarray, "size size 3"], augmentation: Augmentation, rng: np.random.Generator
) -> UInt8[np.ndarray, "size size 3"]:
    gains = np.exp(augmentation.gain_spread * (rng.normal() + 0.5 * rng.normal(size=3)))
    shift = 255.0 * augmentation.brightness_spread * rng.normal()
    table = np.clip(np.arange(256)[:, None] * gains + shift, 0, 255).astype(np.uint8)
    return np.stack([table[image[..., k], k] for k in range(3)], axis=-1)


@dataclass(frozen=True, eq=False)
class HandCrops:
    """A set of hands that are known and can be seen from two sides or more; a map-style data set for torch.

    Attributes:
        hands: Their stored crops.
        labels: Their joints, in the same order.
        augmentation: What is varied.
        size_px: Side of the crops.
        seed: Of everything drawn; with the epoch and the index it decides on a sample.
    """

    hands: tuple[StoredHand, ...]
    labels: tuple[HandLabel, ...]
    augmentation: Augmentation
    size_px: int
    seed: int
    _epoch: list[int] = field(default_factory=lambda: [0])

    @staticmethod
    def of(crops: pa.Table, labels: pa.Table, augmentation: Augmentation, size_px: int, seed: int) -> "HandCrops":
        """Match crops and labels; hands with fewer than two views, or whose root is unknown, are left out."""
        known = hand_labels(labels)
        pairs = [
            (hand, known[key])
            for key, hand in sorted(stored_hands(crops).items())
            if key in known and len(hand.views) >= 2 and known[key].is_valid[ROOT]
        ]
        hands, chosen = (tuple(column) for column in zip(*pairs, strict=True)) if pairs else ((), ())
        return HandCrops(hands, chosen, augmentation, size_px, seed)

    def spread(self, count: int) -> "HandCrops":
        """Return a set of at most so many hands, evenly spread."""
        chosen = np.unique(np.linspace(0, len(self) - 1, min(count, len(self))).round().astype(int)).tolist()
        hands, labels = (tuple(column[index] for index in chosen) for column in (self.hands, self.labels))
        return replace(self, hands=hands, labels=labels)

    def set_epoch(self, epoch: int) -> None:
        """Draw other variations from now on."""
        self._epoch[0] = epoch

    def __len__(self) -> int:
        """Return how many hands there are."""
        return len(self.hands)

    def __getitem__(self, index: int) -> Mapping[str, Any]:
        """Return a sample's arrays by name."""
        rng = np.random.default_rng([self.seed, self._epoch[0], index])
        hand, label = self.hands[index], self.labels[index]
        return vars(draw_sample(hand, label, self.augmentation, self.size_px, rng))
