"""Pictures of a scene, by casting the rays of every pixel through the camera's true lens.

What does not move is pictured once per camera. For each instant the bodies that do move are made into one mesh, rays
are cast at it in the tiles of the picture that it may cover, and its shadows are taken out of the light on the rest.
The same scene, sensor and frame seed give the same bytes, whatever else is drawn before, after or at the same time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float32, Int32, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.background import BackgroundCache, StaticView, static_view
from assemblyhands_core.synthetic.bodies import BACKGROUND_ID, Body, Light, Scene
from assemblyhands_core.synthetic.casting import cast_at
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.sensor import Sensor, quantised
from assemblyhands_core.synthetic.shading import pixel_rad, shade
from assemblyhands_core.synthetic.shadows import LampView

__all__ = [
    "BACKGROUND_ID",
    "BackgroundCache",
    "Body",
    "Light",
    "Rendered",
    "Scene",
    "Sensor",
    "Texture",
    "render",
    "render_crops",
]


@dataclass(frozen=True, eq=False)
class Rendered:
    """A picture.

    Attributes:
        image: RGB `(height, width, 3)`, or grey `(height, width)` from a mono sensor.
        object_id: What the centre of each pixel shows.
    """

    image: UInt8[np.ndarray, "height width *channel"]
    object_id: UInt8[np.ndarray, "height width"]


def render(
    scene: Scene,
    camera: Camera,
    *,
    sensor: Sensor,
    frame_seed: int,
    background_cache: BackgroundCache | None = None,
) -> Rendered:
    """Take the picture of a scene by a camera.

    Args:
        scene: At this instant.
        camera: With its true lens, at its pose at this instant.
        sensor: Of this camera.
        frame_seed: Number of the frame; with the scene's seed and the camera's name it determines the noise.
        background_cache: One per recording: spares casting again what does not move, for cameras that do not either.
    """
    cache = background_cache or BackgroundCache()
    return _take(scene, cache.view(scene, camera), cache, sensor, frame_seed)


def render_crops(
    scene: Scene,
    cameras: Sequence[Camera],
    *,
    sensors: Sequence[Sensor],
    frame_seed: int,
    background_cache: BackgroundCache | None = None,
) -> list[Rendered]:
    """Take pictures directly through crop cameras, which are different ones for every instant.

    Args:
        scene: At this instant.
        cameras: Pinholes from `crop_camera`, or any others.
        sensors: One per camera.
        frame_seed: See `render`.
        background_cache: Keeps only the mesh of what does not move.
    """
    cache = background_cache or BackgroundCache()
    surfaces = cache.surfaces(scene)
    views = (static_view(scene, surfaces, camera) for camera in cameras)
    return [_take(scene, view, cache, sensor, frame_seed) for view, sensor in zip(views, sensors, strict=True)]


def _take(scene: Scene, view: StaticView, cache: BackgroundCache, sensor: Sensor, frame_seed: int) -> Rendered:
    canvas = _Canvas.of(view)
    encoded = view.encoded(sensor)
    if scene.moving:
        _draw_moving(canvas, scene, view, cache)
        encoded = encoded.copy()
        changed = cv2.dilate(canvas.is_changed, np.ones((3, 3), np.uint8))  # the blur of the lens reaches that far
        sensor.encode(canvas.linear, np.flatnonzero(changed).astype(np.int32), encoded, view.camera)
    image = sensor.expose(encoded, view.camera.camera_id, scene.seed, frame_seed)
    return Rendered(image[..., 0] if sensor.is_mono else image, canvas.ids)


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture that is being drawn on."""

    ids: UInt8[np.ndarray, "height width"]
    distances_mm: Float32[np.ndarray, "height width"]
    linear: UInt16[np.ndarray, "height width 3"]
    is_changed: UInt8[np.ndarray, "height width"]

    @staticmethod
    def of(view: StaticView) -> "_Canvas":
        return _Canvas(view.ids.copy(), view.distances_mm.copy(), view.linear.copy(), np.zeros_like(view.ids))


def _draw_moving(canvas: _Canvas, scene: Scene, view: StaticView, cache: BackgroundCache) -> None:
    surfaces, camera = scene.moving_surfaces, view.camera
    pixels, hits = cast_at(camera, view.lens, surfaces, canvas.distances_mm)
    shaded = shade(scene, surfaces, camera, view.lens.world(camera, pixels), hits)
    canvas.ids.ravel()[pixels] = surfaces.ids(hits.faces)
    canvas.is_changed.ravel()[pixels] = 1
    light = shaded.terms[:, 0].copy()
    is_moving = canvas.is_changed.copy()
    guide = canvas.ids, canvas.distances_mm, pixel_rad(camera)
    for index, lamp in enumerate(scene.lights):
        lit = LampView.empty(lamp, canvas.ids.shape)
        lit.ask((surfaces, cache.surfaces(scene)), pixels, shaded.positions_mm.__getitem__, shaded.normals)
        if lamp.casts_shadow:
            receivers = view.receivers(scene, index, is_moving)
            lit.ask((surfaces,), receivers, partial(_positions_mm, view, receivers))
            _darken(canvas.linear, view.direct[index], receivers, lit.shares(receivers, *guide), canvas.is_changed)
        light += lit.shares(pixels, *guide)[:, None] * shaded.terms[:, 1 + index]
    canvas.linear.reshape(-1, 3)[pixels] = quantised(light)


def _positions_mm(
    view: StaticView, pixels: Int32[np.ndarray, " pixel"], asked: Int32[np.ndarray, " asked"]
) -> Float32[np.ndarray, "asked 3"]:
    return view.positions_mm(pixels[asked])


@compiled
def _darken(
    linear: UInt16[np.ndarray, "height width 3"],
    direct: UInt16[np.ndarray, "height width 3"],
    pixels: Int32[np.ndarray, " pixel"],
    shares: Float32[np.ndarray, " pixel"],
    is_changed: UInt8[np.ndarray, "height width"],
) -> None:
    """Take the missing share of a light's part away from pixels."""
    width = linear.shape[1]
    for i in range(len(pixels)):
        if shares[i] < 1:
            row, column = pixels[i] // width, pixels[i] % width
            is_changed[row, column] = 1
            for k in range(3):
                light = np.float32(linear[row, column, k]) - (1 - shares[i]) * np.float32(direct[row, column, k])
                linear[row, column, k] = np.uint16(max(light, np.float32(0)) + np.float32(0.5))
