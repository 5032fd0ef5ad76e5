"""From a take to what is to be drawn at an instant."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from assemblyhands_core.synthetic.bodies import Body, Light, Scene
from assemblyhands_core.synthetic.figure import Figure, Shape
from assemblyhands_core.synthetic.room import draw_lights, furnish
from assemblyhands_core.synthetic.take import State, Take

FIRST_PART_ID: Final = 20
"""Object ids of parts count from here, in the order of `Take.parts`."""


@dataclass(frozen=True, eq=False)
class Studio:
    """A take with everything that is made only once for all of its instants.

    Attributes:
        take: The take.
        figure: The person.
        parts: Shapes of the parts by name.
        static: What never moves.
        lights: The lamps.
    """

    take: Take
    figure: Figure
    parts: dict[str, Shape]
    static: tuple[Body, ...]
    lights: tuple[Light, ...]

    @classmethod
    def of(cls, take: Take) -> "Studio":
        """Furnish the room of a take; furniture and light depend on its seed only."""
        rng = np.random.default_rng([take.seed, 0x900])
        lights, static = draw_lights(rng), furnish(take.subject, rng)
        parts = {name: _shape(take, name, FIRST_PART_ID + i) for i, name in enumerate(take.parts.parts)}
        return cls(take, Figure.of(take.subject, take.kind == "assembly"), parts, static, lights)

    def scene(self, state: State) -> Scene:
        """Return all that is visible in a state of the take."""
        bodies = self.figure.bodies(self.take.subject, state)
        bodies += [shape.moved(state.T_world_from_part[name]) for name, shape in self.parts.items()]
        return Scene(self.static, tuple(bodies), self.lights, seed=self.take.seed)


def scene_at(take: Take, t_s: float) -> Scene:
    """Return all that is visible at an instant of a take; `Scene.static` is the same for all of its instants."""
    return _studio(take).scene(take.state_at(t_s))


@lru_cache(4)
def _studio(take: Take) -> Studio:
    return Studio.of(take)


def _shape(take: Take, name: str, object_id: int) -> Shape:
    part = take.parts.parts[name]
    vertices, albedo = part.vertices_mm.astype(np.float32), part.albedo.astype(np.float32)
    return Shape(
        name, object_id, vertices, part.faces.astype(np.int32), albedo, part.gloss, part.metallic, part.texture
    )
