"""The skin of the average hand, meshed once per process: what every subject's hand is adapted from."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float64, Int32

from assemblyhands_core.synthetic.hand_colour import SkinMarks, skin_marks
from assemblyhands_core.synthetic.hand_field import Capsule, capsules, field_mm, sampled_field_mm
from assemblyhands_core.synthetic.hand_weights import skin_weights

# Grid steps: coarse along forearm and palm, fine along the fingers, where nails and creases are; and across.
_COARSE_MM: Final = 5.5
_FINE_MM: Final = 3.6
_ACROSS_MM: Final = 4.0
_RELAXATIONS: Final = 8
_WEIGHT_SMOOTHINGS: Final = 4


@dataclass(frozen=True, eq=False)
class HandTemplate:
    """A closed triangle mesh of the average right hand in the template pose, in its wrist frame.

    Attributes:
        vertices_mm: On the skin.
        faces: Counter-clockwise seen from outside.
        weights: Share of each bone in the motion of each vertex, see `hand_weights`.
        marks: Where the skin differs in colour.
    """

    vertices_mm: Float64[np.ndarray, "vertex 3"]
    faces: Int32[np.ndarray, "face 3"]
    weights: Float64[np.ndarray, "vertex bone"]
    marks: SkinMarks


@lru_cache(maxsize=1)
def hand_template() -> HandTemplate:
    """Mesh the skin; every edge lies in exactly two faces."""
    from skimage.measure import marching_cubes  # slow to import, and needed once

    axes, flesh = _grid_axes_mm(), capsules()
    corners, faces, _, _ = marching_cubes(sampled_field_mm(axes, flesh), 0.0)
    vertices = np.stack([np.interp(corners[:, i], np.arange(len(axis)), axis) for i, axis in enumerate(axes)], axis=-1)
    faces = faces.astype(np.int32)
    for _ in range(_RELAXATIONS):
        vertices = _onto_skin(_spread(vertices, faces), flesh)
    weights = skin_weights(vertices)
    for _ in range(_WEIGHT_SMOOTHINGS):
        weights = _spread(weights, faces)
    for array in (vertices, faces, weights):
        array.flags.writeable = False
    return HandTemplate(vertices, faces, weights, skin_marks(vertices, vertex_normals(vertices, faces)))


def vertex_normals(
    vertices_mm: Float64[np.ndarray, "vertex 3"], faces: Int32[np.ndarray, "face 3"]
) -> Float64[np.ndarray, "vertex 3"]:
    """Return outward unit normals, the means of the adjacent faces' weighted by area."""
    a, b, c = np.moveaxis(vertices_mm[faces], 1, 0)
    of_faces = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(of_faces[:, i], 3), len(vertices_mm)) for i in range(3)], axis=-1
    )
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def neighbour_mean(
    values: Float64[np.ndarray, "vertex channel"], faces: Int32[np.ndarray, "face 3"]
) -> Float64[np.ndarray, "vertex channel"]:
    """Return the mean of each vertex's neighbours in a closed mesh."""
    total, count = np.zeros_like(values), np.bincount(faces.ravel(), minlength=len(values))
    for a, b in ((0, 1), (1, 2), (2, 0)):
        # In a closed, oriented mesh each neighbour is met exactly once as the head of an edge of a face.
        for channel in range(values.shape[1]):
            total[:, channel] += np.bincount(faces[:, a], weights=values[faces[:, b], channel], minlength=len(values))
    return np.asarray(total / count[:, None])


def _grid_axes_mm() -> tuple[
    Float64[np.ndarray, " width"], Float64[np.ndarray, " height"], Float64[np.ndarray, " depth"]
]:
    along = np.concatenate([np.arange(-80.0, 48.0, _COARSE_MM), np.arange(48.0, 200.0, _FINE_MM)])
    return np.arange(-105.0, 80.0, _ACROSS_MM), along, np.arange(-75.0, 36.0, _ACROSS_MM)


def _spread(
    values: Float64[np.ndarray, "vertex channel"], faces: Int32[np.ndarray, "face 3"]
) -> Float64[np.ndarray, "vertex channel"]:
    """Half a step of Laplacian smoothing."""
    return np.asarray(0.5 * (values + neighbour_mean(values, faces)))


def _onto_skin(
    vertices: Float64[np.ndarray, "vertex 3"], flesh: tuple[Capsule, ...]
) -> Float64[np.ndarray, "vertex 3"]:
    """One Newton step along the gradient of the field."""
    value, gradient = field_mm(vertices, flesh)
    return np.asarray(vertices - (value / np.einsum("vi,vi->v", gradient, gradient))[:, None] * gradient)
