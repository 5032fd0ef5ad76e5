"""Pictures of what does not move in a recording, taken once per camera."""

import numpy as np

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.bodies import Scene
from assemblyhands_core.synthetic.surfaces import Surfaces
from assemblyhands_core.synthetic.views import View, static_view


class BackgroundCache:
    """Views of one recording's static bodies by fixed cameras, and their mesh."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._views: dict[str, View] = {}

    @property
    def num_views(self) -> int:
        """How many cameras' pictures are kept."""
        return len(self._views)

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

    def view(self, scene: Scene, camera: Camera) -> View:
        """Return what a camera sees of the static bodies."""
        surfaces = self.surfaces(scene)
        kept = self._views.get(camera.camera_id)
        if kept is None or not _is_same(kept.camera, camera):
            kept = self._views[camera.camera_id] = static_view(scene, surfaces, camera)
        return kept


def _is_same(a: Camera, b: Camera) -> bool:
    keys = [(c.width_px, c.height_px, c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.lens) for c in (a, b)]
    return keys[0] == keys[1] and np.array_equal(a.T_camera_from_world, b.T_camera_from_world)
