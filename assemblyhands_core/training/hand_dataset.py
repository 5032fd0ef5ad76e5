"""Training sets of hands: each time a hand comes it is seen through other boxes, views and colours.

Where windows leave the stored crop it is continued by its mirror image: a black edge would tell where the true hand is.
Source: paper, supplement B (box expansion γ of mean 1.5, root noise of ±5 mm on every axis); the rest is ours, and each
part can be switched off.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Float32, Float64, UInt8

from assemblyhands_core.data.arrays import evenly_spread
from assemblyhands_core.data.hand_crops import (
    HandKey,
    HandLabel,
    StoredHand,
    cut,
    hand_labels,
    window_map,
)
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
        window = _drawn_window(view.project(known), augmentation, size_px, rng)
        piece = cut(view, window, size_px, is_continued=True)
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
    center, side = square_box(joints_px, 1.0)
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
    """A set of hands that are known and can be seen from two sides or more.

    Attributes:
        hands: Their stored crops.
        labels: Their joints, in the same order.
        augmentation: What is varied.
        size_px: Side of the crops.
        seed: Of everything drawn; with turn and index it decides on a sample.
    """

    hands: tuple[StoredHand, ...]
    labels: tuple[HandLabel, ...]
    augmentation: Augmentation
    size_px: int
    seed: int

    @staticmethod
    def of(
        stored: Mapping[HandKey, StoredHand], labels: pa.Table, augmentation: Augmentation, size_px: int, seed: int
    ) -> "HandCrops":
        """Match crops (`hand_crops.stored_hands`) and the rows of a `training_tables.HAND_LABELS` table.

        Hands with fewer than two views, or whose root is unknown, are left out, like views that no box can be drawn in.
        """
        known = hand_labels(labels)
        pairs = [(_boxable(hand, known[key]), known[key]) for key, hand in sorted(stored.items()) if key in known]
        chosen = [(hand, label) for hand, label in pairs if len(hand.views) >= 2 and label.is_valid[ROOT]]
        hands, found = (tuple(column) for column in zip(*chosen, strict=True)) if chosen else ((), ())
        return HandCrops(hands, found, augmentation, size_px, seed)

    def spread(self, count: int) -> "HandCrops":
        """Return a set of at most so many hands, evenly spread."""
        chosen = evenly_spread(len(self), count)
        hands, labels = (tuple(self.hands[i] for i in chosen), tuple(self.labels[i] for i in chosen))
        return replace(self, hands=hands, labels=labels)

    def __len__(self) -> int:
        """Return how many hands there are."""
        return len(self.hands)

    def sample(self, index: int, turn: int) -> Mapping[str, Any]:
        """Return a sample's arrays by name, other variations of a hand each time."""
        rng = np.random.default_rng([self.seed, turn, index])
        return vars(draw_sample(self.hands[index], self.labels[index], self.augmentation, self.size_px, rng))


def _boxable(hand: StoredHand, label: HandLabel) -> StoredHand:
    """Return a hand with the views in which its known joints span a box: two at least, all before the camera."""
    known = label.joints_world_mm[label.is_valid]
    views = [view for view in hand.views if len(known) >= 2 and np.isfinite(view.project(known)).all()]
    return replace(hand, views=tuple(views))
