"""Which points of bodies cameras see: the truth about occlusion that goes with a recording."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.background import BackgroundCache
from assemblyhands_core.synthetic.bodies import Scene
from assemblyhands_core.synthetic.surfaces import FAR_MM, MISS, Surfaces

TOLERANCE_MM = 25.0
"""How deep a joint may lie under the skin that a camera sees: half a wrist, or a knuckle seen at a slant."""


def visibility(
    scene: Scene,
    cameras: Sequence[Camera],
    points_mm: Float[np.ndarray, "point 3"],
    owner_ids: Int[np.ndarray, " point"] | UInt8[np.ndarray, " point"],
    *,
    tolerance_mm: float = TOLERANCE_MM,
    background_cache: BackgroundCache | None = None,
) -> Bool[np.ndarray, "view point"]:
    """Tell which points cameras see.

    A point is seen if it lies in the picture and the ray towards it meets its owner first, at most `tolerance_mm`
    before the point: further away, another part of the owner hides it.

    Args:
        scene: At this instant.
        cameras: At their poses.
        points_mm: In the world, such as joints.
        owner_ids: The object each belongs to.
        tolerance_mm: How deep below the surface a point that counts as seen may lie.
        background_cache: Of the recording; spares making the mesh of the static bodies.
    """
    static = (background_cache or BackgroundCache()).surfaces(scene)
    parts = static, scene.moving_surfaces
    seen = [_seen(parts, camera, points_mm, owner_ids, tolerance_mm) for camera in cameras]
    return np.array(seen, dtype=bool).reshape(len(cameras), len(points_mm))


def _seen(
    parts: tuple[Surfaces, ...],
    camera: Camera,
    points_mm: Float[np.ndarray, "point 3"],
    owner_ids: Int[np.ndarray, " point"] | UInt8[np.ndarray, " point"],
    tolerance_mm: float,
) -> Bool[np.ndarray, " point"]:
    towards = points_mm - camera.center_world_mm
    distances = np.linalg.norm(towards, axis=-1)
    rays = (towards / distances[:, None]).astype(np.float32)
    nearest, ids = np.full(len(rays), FAR_MM), np.zeros(len(rays), np.uint8)
    for surfaces in parts:
        hits = surfaces.first_hits(camera.center_world_mm.astype(np.float32), rays)
        closer = np.flatnonzero((hits.faces != MISS) & (hits.distances_mm < nearest))
        nearest[closer], ids[closer] = hits.distances_mm[closer], surfaces.ids(hits.faces[closer])
    is_inside = camera.contains(camera.project(points_mm))
    return np.asarray(is_inside & (ids == owner_ids) & (nearest >= distances - tolerance_mm))
