"""The GPU's kernel against the readable form: on a GPU where there is one, else in Triton's interpreter."""

import os

import numpy as np
import pytest
import torch

if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")  # read when triton is imported
pytest.importorskip("triton", reason="triton comes with CUDA builds of torch; its wheel alone runs here, interpreted")

from model_samples import ring_matrices

from assemblyhands_core.geometry.volumes import cube_points_world_mm, unproject_features
from assemblyhands_core.models.fused_unprojection_triton import fused_unproject_features_cuda

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def test_values_and_gradients_are_those_of_the_readable_form() -> None:
    generator = torch.Generator().manual_seed(3)
    features = torch.randn(2, 5, 7, 11, 14, generator=generator).to(DEVICE).requires_grad_()
    points = cube_points_world_mm(torch.zeros(2, 3, device=DEVICE), 500.0, 6)
    matrices = ring_matrices(2, 5, 11).float().to(DEVICE)
    used = torch.tensor([[True, True, False, True, True], [False] * 5], device=DEVICE)
    plain = unproject_features(features, matrices, points, used)
    fused = fused_unproject_features_cuda(features, matrices, points, used)
    upstream = torch.randn(plain.shape, generator=generator).to(DEVICE)
    plain_gradient, fused_gradient = (torch.autograd.grad(volume, features, upstream)[0] for volume in (plain, fused))
    assert fused.is_contiguous(memory_format=torch.channels_last_3d)
    np.testing.assert_allclose(fused.detach().cpu(), plain.detach().cpu(), atol=5e-5)
    np.testing.assert_allclose(fused_gradient.cpu(), plain_gradient.cpu(), atol=5e-5)
    assert plain[0].any() and not fused[1].any()
