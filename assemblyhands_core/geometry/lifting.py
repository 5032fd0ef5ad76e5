"""From joints in a picture to joints in front of its camera: 2.5D and the wrist's depth give 3D.

A joint at pixel u whose depth is the wrist's Z plus d lies at (Z + d) K⁻¹ (u, 1), in the camera's frame. The wrist's
depth comes from elsewhere; where nobody knows it, the size of the hand tells it.

Source: Iqbal et al., Hand Pose Estimation via Latent 2.5D Heatmap Regression (ECCV 2018), Sec. 3.1; that solves for a
single bone, here all bones of the hand together have a known length.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

NEAREST_MM: Final = 50.0
FARTHEST_MM: Final = 5000.0
_HALVINGS: Final = 50  # of the range: far below a micrometre


def lifted_mm(
    pixels: Float[np.ndarray, "hand joint 2"],
    depth_mm: Float[np.ndarray, "hand joint"],
    wrist_depth_mm: Float[np.ndarray, " hand"],
    intrinsics_px: Float[np.ndarray, "hand 4"],
) -> Float64[np.ndarray, "hand joint 3"]:
    """Return joints in their cameras' frames.

    Args:
        pixels: Joints (x, y) in pictures of pinhole cameras.
        depth_mm: Of each joint beyond its wrist, along the optical axis.
        wrist_depth_mm: Of the wrist before the camera.
        intrinsics_px: fx, fy, cx, cy of each hand's camera.
    """
    return np.asarray(sightlines(pixels, intrinsics_px) * (wrist_depth_mm[:, None] + depth_mm)[..., None])


def sightlines(
    pixels: Float[np.ndarray, "hand joint 2"], intrinsics_px: Float[np.ndarray, "hand 4"]
) -> Float64[np.ndarray, "hand joint 3"]:
    """Return K⁻¹ (u, 1): where joints would lie at depth 1."""
    x, y = ((pixels - intrinsics_px[:, None, 2:]) / intrinsics_px[:, None, :2]).transpose(2, 0, 1).astype(np.float64)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def wrist_depth_of_size_mm(
    pixels: Float[np.ndarray, "hand joint=21 2"],
    depth_mm: Float[np.ndarray, "hand joint=21"],
    intrinsics_px: Float[np.ndarray, "hand 4"],
    bones: Sequence[tuple[int, int]],
    bones_mm: float,
) -> Float64[np.ndarray, " hand"]:
    """Return the wrist's depth at which all bones of a hand together are as long as they should be.

    Their length is a convex function of the depth, which grows where hands are wider than deep; the depth is looked for
    between `NEAREST_MM` and `FARTHEST_MM`.

    Args:
        pixels: Joints (x, y) in pictures of pinhole cameras.
        depth_mm: Of each joint beyond its wrist, along the optical axis.
        intrinsics_px: fx, fy, cx, cy of each hand's camera.
        bones: The two joints of each bone.
        bones_mm: Sum of the lengths of the hand's bones.

    Returns:
        NaN where a joint is unknown.
    """
    rays = sightlines(pixels, intrinsics_px)
    beyond = rays * depth_mm[..., None]
    first, second = (list(ends) for ends in zip(*bones, strict=True))
    across, along = rays[:, first] - rays[:, second], beyond[:, first] - beyond[:, second]
    near, far = (np.full(len(rays), limit) for limit in (NEAREST_MM, FARTHEST_MM))
    for _ in range(_HALVINGS):
        middle = (near + far) / 2
        spans = across * middle[:, None, None] + along
        is_too_long = np.linalg.norm(spans, axis=-1).sum(axis=-1) > bones_mm
        near, far = np.where(is_too_long, near, middle), np.where(is_too_long, middle, far)
    return np.where(np.isfinite(across + along).all(axis=(1, 2)), (near + far) / 2, np.nan)
