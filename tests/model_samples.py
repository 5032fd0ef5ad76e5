"""Cameras and hands in random places, for tests of the networks."""

import numpy as np
import torch

DISTANCE_MM = 800.0
FIELD_MM = 250.0  # width of what an image shows at the world's origin


def ring_matrices(batch: int, num_views: int, size_px: int, seed: int = 0) -> torch.Tensor:
    """Projection matrices (batch, view, 3, 4), float64, of cameras all around that look at the world's origin."""
    generator = np.random.default_rng(seed)
    return torch.tensor(
        np.array([[_matrix(generator, size_px) for _ in range(num_views)] for _ in range(batch)]), dtype=torch.float64
    )


def _matrix(generator: np.random.Generator, size_px: int) -> np.ndarray:
    forward, up = generator.normal(size=(2, 3))
    forward /= np.linalg.norm(forward)
    right = np.cross(up, forward)
    right /= np.linalg.norm(right)
    pose = np.column_stack((np.stack((right, np.cross(forward, right), forward)), (0.0, 0.0, DISTANCE_MM)))
    focal_px, center_px = size_px / FIELD_MM * DISTANCE_MM, (size_px - 1) / 2
    return np.array([[focal_px, 0, center_px], [0, focal_px, center_px], [0, 0, 1]]) @ pose
