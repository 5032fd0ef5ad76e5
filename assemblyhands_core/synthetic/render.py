"""Pictures of a scene, by casting the rays of every pixel through the camera's true lens.

What does not move is pictured once per camera. For each instant the bodies that do move are made into one mesh, rays
are cast at it in the tiles of the picture that it may cover, and its shadows are taken out of the light on the rest.
The same scene, sensor and frame seed give the same bytes, whatever else is drawn before, after or at the same time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.background import BackgroundCache
from assemblyhands_core.synthetic.bodies import BACKGROUND_ID, Body, Light, Scene
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.coverage import TILE_PX
from assemblyhands_core.synthetic.materials import Texture
from assemblyhands_core.synthetic.sensor import Sensor
from assemblyhands_core.synthetic.shading import collect
from assemblyhands_core.synthetic.shadows import BLOCK_PX, LampView
from assemblyhands_core.synthetic.surfaces import Surfaces
from assemblyhands_core.synthetic.views import View, complete_view, see_moving
from assemblyhands_core.synthetic.visibility import visibility

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
    "visibility",
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
    is_fixed: bool = True,
) -> Rendered:
    """Take the picture of a scene by a camera.

    Args:
        scene: At this instant.
        camera: With its true lens, at its pose at this instant.
        sensor: Of this camera.
        frame_seed: Number of the frame; with the scene's seed and the camera's name it determines the noise.
        background_cache: One per recording: spares casting again what does not move.
        is_fixed: Whether the camera does not move either; False for those of a headset.
    """
    cache = background_cache or BackgroundCache()
    if not is_fixed or background_cache is None:
        return _take(scene, cache, camera, sensor, frame_seed)
    static = cache.view(scene, camera)
    view, is_changed = _with_moving(static, scene, cache.surfaces(scene))
    noise = sensor.noise_of(camera, scene.seed, frame_seed)
    image = noise.expose(static.encoded(sensor))
    changed = cv2.dilate(is_changed, np.ones((3, 3), np.uint8))  # the blur of the lens reaches that far
    sensor.expose_changed(view.linear, changed, camera, noise, image)
    return Rendered(image[..., 0] if sensor.is_mono else image, view.ids)


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
        background_cache: Keeps the mesh of what does not move.
    """
    cache = background_cache or BackgroundCache()
    pairs = zip(cameras, sensors, strict=True)
    return [_take(scene, cache, camera, sensor, frame_seed) for camera, sensor in pairs]


def _take(scene: Scene, cache: BackgroundCache, camera: Camera, sensor: Sensor, frame_seed: int) -> Rendered:
    view = complete_view(scene, cache.surfaces(scene), camera)
    image = sensor.noise_of(camera, scene.seed, frame_seed).expose(view.encoded(sensor))
    return Rendered(image[..., 0] if sensor.is_mono else image, view.ids)


def _with_moving(
    static: View, scene: Scene, static_surfaces: Surfaces
) -> tuple[View, UInt8[np.ndarray, "height width"]]:
    """Return the view with the moving bodies of a scene and their shadows, and which pixels they changed."""
    view, surfaces = static.copy(), scene.moving_surfaces
    pixels, shaded = see_moving(view, scene)
    is_changed = np.zeros(view.ids.shape, dtype=np.uint8)
    is_changed.ravel()[pixels] = 1
    is_static = is_changed == 0
    shares = np.ones((len(scene.shading_lights), len(pixels)), dtype=np.float32)
    for index, light in enumerate(scene.shading_lights):
        if scene.moving:
            lamp = LampView.empty(light, view.ids.shape)
            lamp.ask((surfaces, static_surfaces), pixels, shaded.positions_mm, shaded.is_facing[index])
            area = _blocks(static.shadow_tiles(scene, index), lamp.blocks.shape)
            darker = lamp.ask_area((surfaces,), area, is_static & static.is_lit(index), static.positions_mm)
            left = view.shares(lamp, darker, np.ones(len(darker), dtype=bool))
            _darken(view.linear, static.direct[index], darker, left, is_changed)
            shares[index] = view.shares(lamp, pixels, shaded.is_facing[index])
    collect(pixels, shaded.terms, shares, view.linear, view.direct)
    return view, is_changed


def _blocks(
    tiles: Bool[np.ndarray, "row column"], shape: tuple[int, ...]
) -> Bool[np.ndarray, "block_row block_column"]:
    """Return the blocks of shadow rays that lie in tiles."""
    factor = TILE_PX // BLOCK_PX
    return tiles.repeat(factor, axis=0).repeat(factor, axis=1)[: shape[0], : shape[1]]


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
