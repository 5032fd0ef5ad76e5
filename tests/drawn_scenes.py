"""Small scenes whose pictures can be worked out by hand, for the tests of the synthetic studio."""

import numpy as np
import trimesh

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Lens, OpenCVLens, OVFishEye62, Pinhole
from assemblyhands_core.synthetic.render import Body, Light, Scene, Sensor

LENSES: dict[str, Lens] = {
    "Pinhole": Pinhole(),
    "OpenCV": OpenCVLens(k1=-0.13, k2=0.12, k3=-0.02, p1=-6e-4, p2=7e-4),
    "OVFishEye62": OVFishEye62(k1=0.27, k2=0.1, k3=-0.33, k4=0.26, k5=-0.1, k6=0.015, p1=1.1e-3, p2=-7e-4),
}
PLAIN = Sensor(gamma=1.0, contrast=0.0, noise=0.0, blur=0.0, vignetting=0.0)
"""Pixel values proportional to light, up to 0.6 of full scale."""

OVERHEAD = Light((0.0, 2000.0, 0.0), 0.0, (2.0, 2.0, 2.0))
"""A point light; a white surface that faces it 2 m below gets half of full brightness."""


def make_camera(model: str = "Pinhole", height_mm: float = 1000.0, size: tuple[int, int] = (320, 240)) -> Camera:
    """Return a camera above the origin that looks straight down: x of the picture is x, y is z of the world."""
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    pose = transforms.rigid(rotation, -rotation @ [0.0, height_mm, 0.0])
    focal = 0.35 * size[0] if model == "OVFishEye62" else 0.7 * size[0]
    middle = (size[0] - 1) / 2 + 0.3, (size[1] - 1) / 2 - 0.2
    return Camera(f"{model} camera", *size, focal, focal, *middle, LENSES[model], pose)


def make_body(
    mesh: trimesh.Trimesh, object_id: int, at_mm: tuple[float, float, float] = (0, 0, 0), albedo: float = 0.5
) -> Body:
    """Return a body from a mesh, moved."""
    vertices = (mesh.vertices + np.array(at_mm)).astype(np.float32)
    color = np.full((len(vertices), 3), albedo, np.float32)
    return Body(f"body {object_id}", object_id, vertices, mesh.faces.astype(np.int32), color, gloss=0.0)


def make_sphere(
    object_id: int, at_mm: tuple[float, float, float], radius_mm: float, albedo: float = 0.5, subdivisions: int = 4
) -> Body:
    """Return a ball."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)
    return make_body(ball, object_id, at_mm, albedo)


def make_floor(object_id: int = 100, size_mm: float = 4000.0, albedo: float = 0.5) -> Body:
    """Return a slab whose top lies at y = 0."""
    return make_body(trimesh.creation.box((size_mm, 20.0, size_mm)), object_id, (0.0, -10.0, 0.0), albedo)


def make_scene(
    static: tuple[Body, ...] = (), moving: tuple[Body, ...] = (), lights: tuple[Light, ...] = (OVERHEAD,), seed: int = 0
) -> Scene:
    """Return a scene without light from around."""
    return Scene(static, moving, lights, seed, ambient=(0.0, 0.0, 0.0), backdrop=(0.0, 0.0, 0.0))
