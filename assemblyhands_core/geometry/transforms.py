"""Rigid transforms as 4×4 matrices, named `T_target_from_source`."""

import numpy as np
from jaxtyping import Float, Float64

MAX_ORTHONORMALITY_ERROR = 1e-5
"""Largest entry of |R Rᵀ - I| that still passes as a rotation (formats: the reference loader rejects worse)."""

MAX_NUMBER = 1e9
"""No number of a camera is larger: lengths of 1000 km in mm, and products of such numbers are still finite."""


def rigid(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "4 4"]:
    """Build `T` with `T @ [x, 1] = [rotation @ x + translation, 1]`; the translation is in the unit of the points."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def inverse(transform: Float[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    """Invert a rigid transform by transposing its rotation."""
    rotation = transform[:3, :3]
    return rigid(rotation.T, -rotation.T @ transform[:3, 3])


def apply(transform: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Map points by a rigid transform; the type of the points is kept."""
    return np.asarray(points @ transform[:3, :3].T.astype(points.dtype) + transform[:3, 3].astype(points.dtype))


def reason_not_rigid(transform: Float[np.ndarray, "..."]) -> str | None:
    """Say why a matrix is no rigid transform, or None when it is one.

    Args:
        transform: Candidate, expected `(4, 4)`.

    Returns:
        The reason as a piece of a sentence, with the offending value.
    """
    if transform.shape != (4, 4):
        return f"it has shape {transform.shape} instead of (4, 4)"
    if not np.isfinite(transform).all():
        return "it contains NaN or infinity"
    if np.abs(transform).max() > MAX_NUMBER:
        return f"it contains {np.abs(transform).max():.2g}, and no number of a pose is larger than {MAX_NUMBER:g}"
    if np.abs(transform[3] - (0.0, 0.0, 0.0, 1.0)).max() > MAX_ORTHONORMALITY_ERROR:
        return f"its last row is {transform[3].tolist()} instead of [0, 0, 0, 1]"
    rotation = transform[:3, :3]
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > MAX_ORTHONORMALITY_ERROR:
        return f"its rotation is not orthonormal (|R Rᵀ - I| = {error:.2g}, allowed {MAX_ORTHONORMALITY_ERROR:g})"
    if np.linalg.det(rotation) < 0:
        return "its rotation is a mirror image (determinant -1)"
    return None
