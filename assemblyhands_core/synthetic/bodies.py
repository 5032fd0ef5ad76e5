"""What a picture is taken of: bodies with a surface, lights, and the scene that holds them at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from jaxtyping import Float32, Int32

from assemblyhands_core.synthetic.coverage import LightMap, ShadowMap
from assemblyhands_core.synthetic.materials import NO_TEXTURE, Texture
from assemblyhands_core.synthetic.surfaces import Surfaces

Color = tuple[float, float, float]
"""Linear (not gamma-encoded) red, green, blue."""

BACKGROUND_ID = 0
"""In an id mask: a pixel that shows nobody."""


@dataclass(frozen=True, eq=False)
class Body:
    """Something that can be drawn: a closed triangle mesh with a material.

    Attributes:
        name: For people; unique in a scene by convention.
        object_id: What the id mask shows, 1..255: 1 right hand, 2 left hand, 3 and 4 their arms; 0 is the background.
        vertices_mm: In the world. Edges between faces that meet at less than 40° are drawn smooth, others sharp.
        faces: Indices of vertices, counter-clockwise seen from outside.
        albedo: Linear RGB in 0..1 per vertex, interpolated over faces.
        gloss: 0 (chalk) over 0.3 (skin), 0.6 (plastic) to 1 (polished).
        metallic: 0 (highlights are white) to 1 (a metal: reflects its surroundings in its own colour).
        texture: Solid pattern, or none.
        rest_mm: The vertices in the body's own frame, where the texture is anchored, so that a moving body takes it
            along; by default `vertices_mm`.
    """

    name: str
    object_id: int
    vertices_mm: Float32[np.ndarray, "vertex 3"]
    faces: Int32[np.ndarray, "face 3"]
    albedo: Float32[np.ndarray, "vertex 3"]
    gloss: float = 0.2
    metallic: float = 0.0
    texture: Texture | None = None
    rest_mm: Float32[np.ndarray, "vertex 3"] | None = None

    def __post_init__(self) -> None:
        if not 0 < self.object_id < 256:
            raise ValueError(f"Body {self.name} has object id {self.object_id}; an id mask holds 1 to 255 only.")
        if self.faces.size and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices_mm):
            raise ValueError(f"Body {self.name}: a face names a vertex beyond its {len(self.vertices_mm)} vertices.")


@dataclass(frozen=True)
class Light:
    """A spherical lamp.

    Attributes:
        position_mm: Its centre in the world.
        radius_mm: Of the lamp: 0 gives hard shadows, 100 to 300 the soft ones of a ceiling panel.
        intensity: Linear RGB; a white surface that faces it at a distance of 1 m gets this bright. Falls off as 1/d².
        casts_shadow: Whether bodies block it; a weak filling light need not.
    """

    position_mm: tuple[float, float, float]
    radius_mm: float = 150.0
    intensity: Color = (1.0, 1.0, 1.0)
    casts_shadow: bool = True


@dataclass(frozen=True, eq=False)
class Scene:
    """All that is visible at one instant.

    Attributes:
        static: Bodies that never move in a recording: the same objects in every scene of it, because pictures of
            them are kept (see `BackgroundCache`).
        moving: Bodies at this instant.
        lights: The same in every scene of a recording.
        seed: Of the recording; with the camera's name and the frame it determines the noise.
        ambient: Light from everywhere, on the side towards the lights; the other side gets about half.
        backdrop: What a ray sees that leaves the scene.
    """

    static: tuple[Body, ...]
    moving: tuple[Body, ...]
    lights: tuple[Light, ...]
    seed: int
    ambient: Color = (0.30, 0.31, 0.33)
    backdrop: Color = (0.06, 0.06, 0.065)

    @cached_property
    def shading_lights(self) -> tuple[Light, ...]:
        """Those of the lights that throw shadows."""
        return tuple(light for light in self.lights if light.casts_shadow)

    @cached_property
    def static_surfaces(self) -> Surfaces:
        """The static bodies as one mesh; rendering takes it from the `BackgroundCache` where there is one."""
        return merged(self.static)

    @cached_property
    def moving_surfaces(self) -> Surfaces:
        """The moving bodies as one mesh, made once for all views of the instant."""
        return merged(self.moving)

    @cached_property
    def shadow_maps(self) -> tuple[ShadowMap, ...]:
        """Where the shadows of the moving bodies lie, for each light that throws any; made once for all views.

        The maps' axes point to the static bodies, so that they are the same for all scenes of a recording.
        """
        middles = [body.vertices_mm.mean(axis=0) for body in self.static] or [np.zeros(3)]
        target = np.stack(middles).mean(axis=0, dtype=np.float64)
        maps = (LightMap.towards(light.position_mm, light.radius_mm, target) for light in self.shading_lights)
        return tuple(ShadowMap.of(around, self.moving_surfaces) for around in maps)


def merged(bodies: Sequence[Body]) -> Surfaces:
    """Merge bodies into one mesh; none at all are allowed."""
    starts = np.cumsum([0, *(len(body.vertices_mm) for body in bodies)])
    rest = [body.vertices_mm if body.rest_mm is None else body.rest_mm for body in bodies]
    textures = [NO_TEXTURE if body.texture is None else body.texture.row() for body in bodies]
    return Surfaces(
        vertices_mm=_stack([body.vertices_mm for body in bodies], np.float32),
        faces=_stack([body.faces + start for body, start in zip(bodies, starts, strict=False)], np.int32),
        albedo=_stack([body.albedo for body in bodies], np.float32),
        rest_mm=_stack(rest, np.float32),
        body_of_face=np.repeat(np.arange(len(bodies), dtype=np.int32), [len(body.faces) for body in bodies]),
        object_ids=np.array([body.object_id for body in bodies], dtype=np.uint8),
        gloss=np.array([body.gloss for body in bodies], dtype=np.float32),
        metallic=np.array([body.metallic for body in bodies], dtype=np.float32),
        textures=np.array(textures, dtype=np.float32).reshape(-1, len(NO_TEXTURE)),
    )


def _stack(parts: Sequence[npt.NDArray[Any]], dtype: type[np.generic]) -> npt.NDArray[Any]:
    return np.concatenate(parts).astype(dtype, copy=False) if len(parts) else np.zeros((0, 3), dtype)
