"""Features of several views fused into one volume, by the fastest form that the tensors' device has."""

import importlib.util
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from assemblyhands_core.geometry.volumes import unproject_features

Form = Literal["auto", "plain", "fused"]


def fuse_views(
    features: Float[Tensor, "batch view channel height width"],
    P_pixel_from_world: Float[Tensor, "batch view 3 4"],
    points_world_mm: Float[Tensor, "batch x y z 3"],
    is_view_used: Bool[Tensor, "batch view"],
    form: Form = "auto",
) -> Float[Tensor, "batch channel x y z"]:
    """Return what `geometry.volumes.unproject_features` returns, which see; all forms agree in values and gradients.

    Args:
        features: Feature maps.
        P_pixel_from_world: Into pixels of the feature maps.
        points_world_mm: Voxels.
        is_view_used: Views to leave out are false.
        form: "plain" is the readable form, "fused" numba's loop on the CPU and Triton's kernel on CUDA, "auto" the
            fused form where there is one.

    Raises:
        ValueError: A fused form was asked for on a device that has none.
    """
    device = features.device.type
    if form == "plain" or (form == "auto" and not _has_fused_form(device)):
        return unproject_features(features, P_pixel_from_world, points_world_mm, is_view_used)
    if not _has_fused_form(device):
        raise ValueError(f"There is no fused unprojection for device {device}: use form 'auto', or install triton.")
    if device == "cuda":
        from assemblyhands_core.models.fused_unprojection_triton import fused_unproject_features_cuda

        return fused_unproject_features_cuda(features, P_pixel_from_world, points_world_mm, is_view_used)
    from assemblyhands_core.models.fused_unprojection import fused_unproject_features

    return fused_unproject_features(features, P_pixel_from_world, points_world_mm, is_view_used)


def scaled_matrices(
    P_pixel_from_world: Float[Tensor, "batch view 3 4"], stride: int
) -> Float[Tensor, "batch view 3 4"]:
    """Return the matrices into an image that is smaller by the stride: u becomes (u + 1/2)/stride - 1/2."""
    scale, shift = 1 / stride, 0.5 / stride - 0.5
    last = P_pixel_from_world[..., 2:, :]
    return torch.cat((P_pixel_from_world[..., :2, :] * scale + shift * last, last), dim=-2)


def _has_fused_form(device: str) -> bool:
    return device == "cpu" or (device == "cuda" and importlib.util.find_spec("triton") is not None)
