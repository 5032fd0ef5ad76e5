"""A camera's look at bodies: what every pixel sees, and how bright it is."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8, UInt16

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.bodies import BACKGROUND_ID, Scene
from assemblyhands_core.synthetic.casting import cast_all, cast_at
from assemblyhands_core.synthetic.coverage import tile_samples
from assemblyhands_core.synthetic.lens_rays import LensRays
from assemblyhands_core.synthetic.sensor import Sensor
from assemblyhands_core.synthetic.shading import WHITE, Shaded, collect, pixel_rad, shade
from assemblyhands_core.synthetic.shadows import LampView
from assemblyhands_core.synthetic.surfaces import FAR_MM, MISS, Hits, Surfaces

Points = tuple[Int32[np.ndarray, " _"], Shaded]
"""Pixels, as flat indices, and what they show."""


@dataclass(frozen=True, eq=False)
class View:
    """What a camera sees, with what is needed to add bodies and their shadows.

    Attributes:
        camera: At its pose.
        lens: Its rays.
        ids: Object shown.
        distances_mm: Along the ray; `FAR_MM` where nothing is met.
        linear: The picture, see `shading.WHITE`; black outside the field of the lens.
        direct: The part in it of each of the lights that throw shadows, which these take away.
    """

    camera: Camera
    lens: LensRays
    ids: UInt8[np.ndarray, "height width"]
    distances_mm: Float32[np.ndarray, "height width"]
    linear: UInt16[np.ndarray, "height width 3"]
    direct: UInt16[np.ndarray, "light height width 3"]
    _encoded: dict[Sensor, UInt16[np.ndarray, "height width channel"]] = field(default_factory=dict)
    _is_lit: dict[int, Bool[np.ndarray, "height width"]] = field(default_factory=dict)
    _spans: dict[int, Float32[np.ndarray, "row column 5"]] = field(default_factory=dict)

    @staticmethod
    def empty(camera: Camera, num_lights: int) -> "View":
        """Return a black view of nothing."""
        shape = camera.height_px, camera.width_px
        ids = np.full(shape, BACKGROUND_ID, dtype=np.uint8)
        distances = np.full(shape, FAR_MM, dtype=np.float32)
        linear = np.zeros((*shape, 3), dtype=np.uint16)
        return View(
            camera, LensRays.of(camera), ids, distances, linear, np.zeros((num_lights, *linear.shape), np.uint16)
        )

    def copy(self) -> "View":
        """Return a view to draw on; the parts of the lights stay this view's."""
        return View(
            self.camera, self.lens, self.ids.copy(), self.distances_mm.copy(), self.linear.copy(), self.direct[:0]
        )

    def encoded(self, sensor: Sensor) -> UInt16[np.ndarray, "height width channel"]:
        """Return the picture as a sensor encodes it, made once."""
        if sensor not in self._encoded:
            self._encoded[sensor] = sensor.encode(self.linear, self.camera)
        return self._encoded[sensor]

    def positions_mm(self, pixels: Int32[np.ndarray, " pixel"]) -> Float32[np.ndarray, "pixel 3"]:
        """Return the points that pixels show."""
        return self.lens.points(self.camera, pixels, self.distances_mm)

    def shadow_tiles(self, scene: Scene, light: int) -> Bool[np.ndarray, "row column"]:
        """Return the tiles that the moving bodies of a scene may keep some of a light from; it throws shadows."""
        shadows = scene.shadow_maps[light]
        if light not in self._spans:
            positions = self.positions_mm(tile_samples(self.distances_mm.shape))
            self._spans[light] = shadows.around.spans(positions, self.distances_mm)
        return shadows.tiles(self._spans[light])

    def is_lit(self, light: int) -> Bool[np.ndarray, "height width"]:
        """Tell which pixels get light from a lamp, made once."""
        if light not in self._is_lit:
            red, green, blue = np.moveaxis(self.direct[light], -1, 0)
            self._is_lit[light] = (red | green | blue) > 0
        return self._is_lit[light]

    def shares(
        self, lamp: LampView, pixels: Int32[np.ndarray, " pixel"], is_facing: Bool[np.ndarray, " pixel"]
    ) -> Float32[np.ndarray, " pixel"]:
        """Return the share of a lamp that reaches what pixels show, 1 where that does not face it."""
        return lamp.shares(pixels, is_facing, self.ids, self.distances_mm, pixel_rad(self.camera))


def static_view(scene: Scene, static: Surfaces, camera: Camera) -> View:
    """Return what a camera sees of the static bodies."""
    view = View.empty(camera, len(scene.shading_lights))
    pixels, hits = _look(view, scene, static)
    _light(view, scene, (static,), [_shaded(view, scene, static, pixels, hits)])
    return view


def complete_view(scene: Scene, static: Surfaces, camera: Camera) -> View:
    """Return what a camera sees of all bodies: the short way to a single picture."""
    view = View.empty(camera, 0)
    pixels, hits = _look(view, scene, static)
    moving = see_moving(view, scene)
    is_free = np.ones(view.ids.size, dtype=bool)
    is_free[moving[0]] = False
    free = np.flatnonzero(is_free[pixels])
    around = _shaded(view, scene, static, pixels[free], hits.select(free))
    _light(view, scene, (scene.moving_surfaces, static), [around, moving])
    return view


def see_moving(view: View, scene: Scene) -> Points:
    """Draw the moving bodies of a scene into a view, but for their light."""
    surfaces = scene.moving_surfaces
    pixels, hits = cast_at(view.camera, view.lens, surfaces, view.distances_mm)
    view.ids.ravel()[pixels] = surfaces.ids(hits.faces)
    return _shaded(view, scene, surfaces, pixels, hits)


def _look(view: View, scene: Scene, static: Surfaces) -> tuple[Int32[np.ndarray, " met"], Hits]:
    """Note what all pixels see; return those that see a surface, and where their rays meet it."""
    hits = cast_all(view.camera, view.lens, static)
    met = np.flatnonzero(hits.faces != MISS)
    if len(met) < view.ids.size:
        missed = np.flatnonzero((hits.faces == MISS) & ~np.isnan(view.lens.rays[..., 0].ravel()))
        view.linear.reshape(-1, 3)[missed] = np.rint(np.array(scene.backdrop) * WHITE)
        hits = hits.select(met)
    view.ids.ravel()[met] = static.ids(hits.faces)
    view.distances_mm.ravel()[met] = hits.distances_mm
    return met.astype(np.int32), hits


def _shaded(view: View, scene: Scene, surfaces: Surfaces, pixels: Int32[np.ndarray, " pixel"], hits: Hits) -> Points:
    return pixels, shade(scene, surfaces, view.camera, view.lens.world(view.camera, pixels), hits)


def _light(view: View, scene: Scene, blockers: tuple[Surfaces, ...], parts: list[Points]) -> None:
    """Put the light on all that a view shows."""
    shares = [np.empty((len(scene.shading_lights), len(pixels)), dtype=np.float32) for pixels, _ in parts]
    for index, light in enumerate(scene.shading_lights):
        lamp = LampView.empty(light, view.ids.shape)
        for pixels, shaded in parts:
            lamp.ask(blockers, pixels, shaded.positions_mm, shaded.is_facing[index])
        for share, (pixels, shaded) in zip(shares, parts, strict=True):
            share[index] = view.shares(lamp, pixels, shaded.is_facing[index])
    for share, (pixels, shaded) in zip(shares, parts, strict=True):
        collect(pixels, shaded.terms, share, view.linear, view.direct)
