"""Left hands seen as right ones: image, camera and world mirrored together, never the image alone.

With S = diag(-1, 1, 1) a point X becomes S X, a rotation S R S, a translation S t, and a camera's c_x becomes
W - 1 - c_x: pixel (u, v) becomes (W - 1 - u, v), which is the flipped image. As a matrix, P becomes M P diag(S, 1) with
M u = W - 1 - u. Every function takes a flag per item and leaves the others as they are; each is its own inverse.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor


def mirrored_images(
    images: Float[Tensor, "batch *view channel height width"], is_mirrored: Bool[Tensor, " batch"]
) -> Float[Tensor, "batch *view channel height width"]:
    """Flip the images of flagged items left to right."""
    return torch.where(_spread(is_mirrored, images), images.flip(-1), images)


def mirrored_points(
    points_world_mm: Float[Tensor, "batch *point 3"], is_mirrored: Bool[Tensor, " batch"]
) -> Float[Tensor, "batch *point 3"]:
    """Turn the x of flagged items' points round."""
    signs = points_world_mm.new_tensor((-1.0, 1.0, 1.0))
    return torch.where(_spread(is_mirrored, points_world_mm), points_world_mm * signs, points_world_mm)


def mirrored_matrices(
    P_pixel_from_world: Float[Tensor, "batch view 3 4"], width_px: int, is_mirrored: Bool[Tensor, " batch"]
) -> Float[Tensor, "batch view 3 4"]:
    """Mirror the projection matrices of flagged items, for images of the given width."""
    signs = P_pixel_from_world.new_tensor((-1.0, 1.0, 1.0, 1.0))
    x, y, depth = P_pixel_from_world.unbind(-2)
    flipped = torch.stack(((width_px - 1) * depth - x, y, depth), dim=-2) * signs
    return torch.where(_spread(is_mirrored, P_pixel_from_world), flipped, P_pixel_from_world)


def mirrored_pixels(
    pixels: Float[Tensor, "batch joint 2"], width_px: int, is_mirrored: Bool[Tensor, " batch"]
) -> Float[Tensor, "batch joint 2"]:
    """Return W - 1 - u for the pixels of flagged items."""
    flipped = torch.stack((width_px - 1 - pixels[..., 0], pixels[..., 1]), dim=-1)
    return torch.where(_spread(is_mirrored, pixels), flipped, pixels)


def _spread(flags: Bool[Tensor, " batch"], like: Tensor) -> Bool[Tensor, "batch ..."]:
    return flags.view(-1, *[1] * (like.ndim - 1))
