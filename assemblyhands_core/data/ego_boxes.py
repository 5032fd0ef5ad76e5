"""Which hands of an egocentric picture become crops, and whose joints a crop shows (paper, supplement, "Processing of
egocentric images": boxes enclose the projected joints, one crop a hand; crops too near the border are left out)."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float

from assemblyhands_core.geometry.crops import square_box
from assemblyhands_core.hands.joints import Hand

UNKNOWN_HAND: Final = "unknown_hand"
BEHIND_CAMERA: Final = "behind_camera"
OUTSIDE_VIEW: Final = "outside_view"
TOO_FEW_JOINTS: Final = "too_few_joints"
NEAR_BORDER: Final = "near_border"
NO_BOX: Final = "no_box"

MIN_GIVEN_JOINTS: Final = 10
MIN_GIVEN_SIDE_PX: Final = 100.0
"""Of hands that come with a box: what the toolkit asks for (formats 2.1, 2.7)."""

Identity = Literal["right", "left", "both"]
IDENTITIES: Final[tuple[Identity, ...]] = ("right", "left", "both")
"""What a crop can show."""


@dataclass(frozen=True)
class EgoRule:
    """Which crops are made.

    Attributes:
        gamma: Side of the crop over the extent of the joints.
        min_joints: Of the hand in the picture; with fewer there is no crop.
        min_border_px: Least distance of the hand's joints to the border of the picture; negative lets some leave it.
        min_other_share: Share of the other hand's joints in the crop from which on it shows both hands.
    """

    gamma: float
    min_joints: int
    min_border_px: float
    min_other_share: float


@dataclass(frozen=True, eq=False)
class EgoBox:
    """What becomes of a hand in a picture.

    Attributes:
        center_px, side_px: The square around its joints; NaN without one.
        num_in_image: Its joints within the picture.
        border_px: Least distance of its joints to the border, below 0 where they leave the picture; NaN if unknown.
        reason: Why there is no crop; empty if there is.
    """

    center_px: Float[np.ndarray, "2"]
    side_px: float
    num_in_image: int
    border_px: float
    reason: str

    def contains(self, pixels: Float[np.ndarray, "point 2"]) -> Bool[np.ndarray, " point"]:
        """Tell which points lie in the box; NaN never does."""
        return np.asarray((np.abs(pixels - self.center_px) <= self.side_px / 2).all(axis=-1))


def ego_box(
    joints_px: Float[np.ndarray, "joint=21 2"],
    is_known: Bool[np.ndarray, "joint=21"],
    size_px: tuple[int, int],
    rule: EgoRule,
) -> EgoBox:
    """Return the box of a hand in a rectified picture, or why there is none.

    Args:
        joints_px: Its projected joints; NaN behind the camera.
        is_known: Which joints are annotated.
        size_px: Width and height of the picture.
        rule: Which crops are made.
    """
    if not is_known.any():
        return no_box(UNKNOWN_HAND)
    pixels = joints_px[is_known]
    if np.isnan(pixels).any():
        return no_box(BEHIND_CAMERA)
    border_px = np.minimum(pixels + 0.5, np.array(size_px) - 0.5 - pixels).min(axis=-1)
    num_in_image, nearest_px = int((border_px >= 0).sum()), float(border_px.min())
    center_px, side_px = square_box(pixels, rule.gamma)
    if reason := _reason(num_in_image, nearest_px, rule):
        return EgoBox(np.full(2, np.nan), float("nan"), num_in_image, nearest_px, reason)
    return EgoBox(center_px, side_px, num_in_image, nearest_px, "")


def given_box(
    box_px: Float[np.ndarray, "4"],
    joints_px: Float[np.ndarray, "joint=21 2"],
    is_known: Bool[np.ndarray, "joint=21"],
    size_px: tuple[int, int],
    rule: EgoRule,
) -> EgoBox:
    """Return the box of a hand around a rectangle that comes with the picture, as the toolkit does (formats 2.7).

    A hand with some valid joints, but fewer than `MIN_GIVEN_JOINTS`, is left out; one without any is to be predicted.

    Args:
        box_px: Left, top, right, bottom.
        joints_px: The hand's projected joints, which tell how near the border it is; NaN where unknown.
        is_known: Which joints are annotated; none in pictures of a test.
        size_px: Width and height of the picture.
        rule: γ.
    """
    corners = box_px.reshape(2, 2)
    shown = joints_px[is_known] if is_known.any() else corners
    border_px = np.minimum(shown + 0.5, np.array(size_px) - 0.5 - shown).min(axis=-1)
    num_in_image = int((border_px >= 0).sum()) if is_known.any() else 0
    if 0 < is_known.sum() < MIN_GIVEN_JOINTS:
        return EgoBox(np.full(2, np.nan), float("nan"), num_in_image, float(border_px.min()), TOO_FEW_JOINTS)
    side_px = max(rule.gamma * float((corners[1] - corners[0]).max()), MIN_GIVEN_SIDE_PX)
    return EgoBox(corners.mean(axis=0), side_px, num_in_image, float(border_px.min()), "")


def identity_of(
    box: EgoBox,
    hand: Hand,
    other_px: Float[np.ndarray, "joint=21 2"],
    is_other_known: Bool[np.ndarray, "joint=21"],
    rule: EgoRule,
) -> Identity:
    """Return whose joints the crop of a hand shows: its own, or both hands'."""
    is_both = is_other_known.any() and box.contains(other_px[is_other_known]).mean() >= rule.min_other_share
    return "both" if is_both else hand


def _reason(num_in_image: int, border_px: float, rule: EgoRule) -> str:
    if num_in_image == 0:
        return OUTSIDE_VIEW
    if num_in_image < rule.min_joints:
        return TOO_FEW_JOINTS
    return NEAR_BORDER if border_px < rule.min_border_px else ""


def no_box(reason: str) -> EgoBox:
    """Return what becomes of a hand that cannot be projected at all."""
    return EgoBox(np.full(2, np.nan), float("nan"), 0, float("nan"), reason)
