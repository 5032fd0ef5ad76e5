"""The picture of what does not move, taken once per camera."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32, Int32, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.bodies import BACKGROUND_ID, Scene
from assemblyhands_core.synthetic.coverage import LightMap, lit_pixels, tile_samples
from assemblyhands_core.synthetic.lens_rays import LensRays
from assemblyhands_core.synthetic.sensor import Sensor, quantised
from assemblyhands_core.synthetic.shading import Shaded, pixel_rad, shade
from assemblyhands_core.synthetic.shadows import LampView
from assemblyhands_core.synthetic.surfaces import FAR_MM, MISS, Surfaces

_BAND_PIXELS = 1 << 17  # cast at a time, so that a large picture needs little memory beside itself


@dataclass(frozen=True, eq=False)
class StaticView:
    """What a camera sees of the bodies that do not move, with what is needed to add others and their shadows.

    Attributes:
        camera: At its pose.
        lens: Its rays.
        ids: Object shown.
        distances_mm: Along the ray; `FAR_MM` where nothing is met.
        linear: The picture, see `sensor.WHITE`; black outside the field of the lens.
        direct: The share of each of the scene's lights in it, which a shadow takes away.
    """

    camera: Camera
    lens: LensRays
    ids: UInt8[np.ndarray, "height width"]
    distances_mm: Float32[np.ndarray, "height width"]
    linear: UInt16[np.ndarray, "height width 3"]
    direct: UInt16[np.ndarray, "light height width 3"]
    _encoded: dict[Sensor, UInt16[np.ndarray, "height width channel"]] = field(default_factory=dict)
    _spans: dict[int, tuple[LightMap, Float32[np.ndarray, "row column 5"]]] = field(default_factory=dict)

    def encoded(self, sensor: Sensor) -> UInt16[np.ndarray, "height width channel"]:
        """Return the picture as a sensor encodes it, made once."""
        if sensor not in self._encoded:
            image = np.empty((*self.ids.shape, sensor.num_channels), np.uint16)
            sensor.encode(self.linear, np.arange(self.ids.size, dtype=np.int32), image, self.camera)
            self._encoded[sensor] = image
        return self._encoded[sensor]

    def positions_mm(self, pixels: Int32[np.ndarray, " pixel"]) -> Float32[np.ndarray, "pixel 3"]:
        """Return the points that pixels show."""
        rays = self.lens.world(self.camera, pixels)
        rays *= self.distances_mm.ravel()[pixels, None]
        rays += self.camera.center_world_mm.astype(np.float32)
        return rays

    def receivers(
        self, scene: Scene, light: int, is_covered: UInt8[np.ndarray, "height width"]
    ) -> Int32[np.ndarray, " pixel"]:
        """Return the pixels that the moving bodies of a scene may keep some of a light from, less those covered."""
        around, spans = self._receiver_spans(scene, light)
        return lit_pixels(around.shadow_tiles(scene.moving_surfaces, spans), self.direct[light], is_covered)

    def _receiver_spans(self, scene: Scene, light: int) -> tuple[LightMap, Float32[np.ndarray, "row column 5"]]:
        """Return the map around a light and where on it the tiles of the picture lie, made once."""
        if light not in self._spans:
            lamp = scene.lights[light]
            samples, known = tile_samples(self.distances_mm)
            points = self.positions_mm(samples.ravel()).reshape(*samples.shape, 3)
            target = points[known].mean(axis=0) if known.any() else np.zeros(3)
            around = LightMap.towards(lamp.position_mm, lamp.radius_mm, target.astype(np.float64))
            self._spans[light] = around, around.spans(points, known)
        return self._spans[light]


class BackgroundCache:
    """Views of one recording's static bodies: the last one of each camera, made anew when the camera has moved."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._views: dict[str, StaticView] = {}

    def surfaces(self, scene: Scene) -> Surfaces:
        """Return the static bodies as one mesh, made once.

        Raises:
            ValueError: The scene has other static bodies or lights than those seen before.
        """
        if self._scene is None:
            self._scene = scene
        same = list(map(id, scene.static)) == list(map(id, self._scene.static))
        settings = (scene.lights, scene.ambient, scene.backdrop)
        if not same or settings != (self._scene.lights, self._scene.ambient, self._scene.backdrop):
            raise ValueError(
                "The static bodies or lights of this scene are not those that the background cache has pictures of: "
                "make a new BackgroundCache for each recording and keep its static bodies the same objects."
            )
        return self._scene.static_surfaces

    def view(self, scene: Scene, camera: Camera) -> StaticView:
        """Return what a camera sees of the static bodies."""
        surfaces = self.surfaces(scene)
        kept = self._views.get(camera.camera_id)
        if kept is None or not _is_same(kept.camera, camera):
            kept = self._views[camera.camera_id] = static_view(scene, surfaces, camera)
        return kept


def _is_same(a: Camera, b: Camera) -> bool:
    keys = [(c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.lens) for c in (a, b)]
    return keys[0] == keys[1] and np.array_equal(a.T_camera_from_world, b.T_camera_from_world)


def static_view(scene: Scene, surfaces: Surfaces, camera: Camera) -> StaticView:
    """Cast all rays of a camera at the static bodies and shade what they meet."""
    shape = camera.height_px, camera.width_px
    lens = LensRays.of(camera)
    ids = np.full(shape, BACKGROUND_ID, dtype=np.uint8)
    distances = np.full(shape, FAR_MM, dtype=np.float32)
    linear = np.zeros((*shape, 3), dtype=np.uint16)
    direct = np.zeros((len(scene.lights), *shape, 3), dtype=np.uint16)
    parts = [_cast_band(scene, surfaces, camera, lens, pixels, ids, distances, linear) for pixels in _bands(ids.size)]
    pixels = np.concatenate([part[0] for part in parts])
    shaded = Shaded.joined([part[1] for part in parts])
    linear.reshape(-1, 3)[pixels] = quantised(shaded.terms[:, 0])
    for light, lamp in enumerate(scene.lights):
        view = LampView.empty(lamp, shape)
        view.ask((surfaces,), pixels, shaded.positions_mm.__getitem__, shaded.normals)
        share = view.shares(pixels, ids, distances, pixel_rad(camera))
        direct[light].reshape(-1, 3)[pixels] = quantised(shaded.terms[:, 1 + light] * share[:, None])
        np.minimum(linear, 65535 - direct[light], out=linear)
        linear += direct[light]
    return StaticView(camera, lens, ids, distances, linear, direct)


def _cast_band(
    scene: Scene,
    surfaces: Surfaces,
    camera: Camera,
    lens: LensRays,
    pixels: Int32[np.ndarray, " pixel"],
    ids: UInt8[np.ndarray, "height width"],
    distances: Float32[np.ndarray, "height width"],
    linear: UInt16[np.ndarray, "height width 3"],
) -> tuple[Int32[np.ndarray, " met"], Shaded]:
    """Note what some pixels see; return those that see a surface and how bright it is."""
    rays = lens.world(camera, pixels)
    hits = surfaces.first_hits(camera.center_world_mm.astype(np.float32), rays)
    met = np.flatnonzero(hits.faces != MISS)
    missed = pixels[(hits.faces == MISS) & ~np.isnan(rays[:, 0])]
    linear.reshape(-1, 3)[missed] = quantised(np.array(scene.backdrop, dtype=np.float32))
    pixels, rays, hits = pixels[met], rays[met], hits.select(met)
    ids.ravel()[pixels] = surfaces.ids(hits.faces)
    distances.ravel()[pixels] = hits.distances_mm
    return pixels, shade(scene, surfaces, camera, rays, hits)


def _bands(count: int) -> Iterator[Int32[np.ndarray, " pixel"]]:
    for start in range(0, count, _BAND_PIXELS):
        yield np.arange(start, min(start + _BAND_PIXELS, count), dtype=np.int32)
