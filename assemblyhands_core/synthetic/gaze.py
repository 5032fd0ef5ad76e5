"""Where the head is and looks: at the hands, a little late and unsteady, sometimes somewhere else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64

from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.synthetic.motion import minimum_jerk
from assemblyhands_core.synthetic.mounts import look_at
from assemblyhands_core.synthetic.person import Posture

_HEAD_MM: Final = np.array([48.0, 138.0, 0.0])
"""Middle of the head above the base of the neck, head upright."""
_DESK_MM: Final = np.array([70.0, 90.0, 80.0])
_EYES_DOWN_MM: Final = np.array([60.0, 150.0, 0.0])
"""The head turns to a point above the hands; the eyes look down the rest."""
_EAGERNESS: Final = 0.7
"""Share of the hands' way from the middle of the desk that the head follows; the eyes do the rest."""
_UNREST_HZ: Final = np.array([0.11, 0.29, 0.53])
_UNREST_MM: Final = 14.0
_MEAN_GLANCES_PER_S: Final = 1 / 25.0
_TURN_S: Final = 0.45


@dataclass(frozen=True)
class Glance:
    """A look at something else: the head turns by `offset_mm` of its target, stays and comes back."""

    start_s: float
    end_s: float
    offset_mm: tuple[float, float, float]

    def share(self, t_s: float) -> float:
        """Return how far the head is turned at an instant, 0 to 1."""
        return minimum_jerk((t_s - self.start_s) / _TURN_S) * minimum_jerk((self.end_s - t_s) / _TURN_S)


@dataclass(frozen=True)
class Gaze:
    """The habits of a head in one take."""

    phases_rad: tuple[tuple[float, ...], ...]
    glances: tuple[Glance, ...]

    @classmethod
    def from_rng(cls, rng: np.random.Generator, duration_s: float) -> "Gaze":
        """Draw when the person looks elsewhere."""
        phases = rng.uniform(0.0, 2 * np.pi, (len(_UNREST_HZ), 4))
        glances, t_s = [], float(rng.exponential(1 / _MEAN_GLANCES_PER_S))
        while t_s < duration_s:
            end_s = t_s + float(rng.uniform(1.2, 2.6))
            side = 1.0 if rng.random() < 0.5 else -1.0
            offset = (float(rng.uniform(50, 250)), float(rng.uniform(0, 350)), side * float(rng.uniform(250, 650)))
            glances.append(Glance(t_s, end_s, offset))
            t_s = end_s + float(rng.exponential(1 / _MEAN_GLANCES_PER_S))
        return cls(tuple(tuple(float(p) for p in row) for row in phases), tuple(glances))

    def T_headset_from_world(
        self, t_s: float, posture: Posture, hands_mm: Mapping[Hand, Float64[np.ndarray, "3"]]
    ) -> Float64[np.ndarray, "4 4"]:
        """Return the pose of the headset, whose frame is that of `headset`.

        Args:
            t_s: The instant.
            posture: Of trunk and neck.
            hands_mm: Where the hands are on average around the instant, world.
        """
        target = _DESK_MM + _EAGERNESS * (0.5 * sum(hands_mm[hand] for hand in HANDS) - _DESK_MM)
        waves = np.sin(2 * np.pi * _UNREST_HZ[:, None] * t_s + np.array(self.phases_rad)).sum(axis=0)
        target = target + _EYES_DOWN_MM + _UNREST_MM * waves[:3]
        for glance in self.glances:
            target = target + glance.share(t_s) * np.array(glance.offset_mm)
        trunk = posture.T_world_from_trunk[:3, :3]
        head = posture.neck_mm + 0.5 * (trunk @ _HEAD_MM) + 0.5 * _HEAD_MM
        return look_at(head, np.asarray(target), np.array([0.0, 1.0, 0.0]), float(0.02 * waves[3]))
