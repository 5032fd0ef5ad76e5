"""Where crops are cut: square windows of rectified views around a hand, around a point, or anywhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import square_box


@dataclass(frozen=True, eq=False)
class Windows:
    """Square windows of rectified views; as a box, exactly these.

    Attributes:
        centers_px: Of each view's window; NaN where a view has none.
        sides_px: In the rectified view; NaN where a view has none.
    """

    centers_px: Float64[np.ndarray, "view 2"]
    sides_px: Float64[np.ndarray, " view"]

    def windows(
        self, cameras: Sequence[Camera], joints_world_mm: Float64[np.ndarray, "joint=21 3"], rng: np.random.Generator
    ) -> "Windows":
        """Return these windows.

        Raises:
            ValueError: They are not as many as the cameras.
        """
        if len(self.sides_px) != len(cameras):
            raise ValueError(
                f"{len(self.sides_px)} windows are given for {len(cameras)} cameras; give one for each, NaN for none."
            )
        return self


@runtime_checkable
class CropBox(Protocol):
    """Decides where crops of a hand are cut."""

    def windows(
        self, cameras: Sequence[Camera], joints_world_mm: Float64[np.ndarray, "joint=21 3"], rng: np.random.Generator
    ) -> Windows:
        """Return a window in each rectified view, NaN where there is none.

        Args:
            cameras: Rectified.
            joints_world_mm: The true joints of the hand.
            rng: Decides on whatever noise there is.
        """
        ...


@dataclass(frozen=True)
class AroundHand:
    """A box around the true hand, expanded by γ, with the errors of a detector: L = γ · the hand's extent.

    Attributes:
        gamma: Expansion; 1.5 on average in the paper (supplement, "Processing of exocentric images").
        gamma_spread: Standard deviation of ln γ, independently in each view.
        center_spread: Standard deviation of the centre along x and y, as a share of the side.
    """

    gamma: float = 1.5
    gamma_spread: float = 0.0
    center_spread: float = 0.0

    def windows(
        self, cameras: Sequence[Camera], joints_world_mm: Float64[np.ndarray, "joint=21 3"], rng: np.random.Generator
    ) -> Windows:
        """Return the windows; a view has none where part of the hand lies behind the camera."""
        noise = rng.normal(size=(len(cameras), 3))
        boxes = [self._box(camera.project(joints_world_mm)) for camera in cameras]
        sides = np.array([side for _, side in boxes]) * np.exp(self.gamma_spread * noise[:, 0])
        centers = np.stack([center for center, _ in boxes]) + self.center_spread * sides[:, None] * noise[:, 1:]
        return Windows(centers, sides)

    def _box(self, joints_px: Float64[np.ndarray, "joint=21 2"]) -> tuple[Float[np.ndarray, "2"], float]:
        if np.isnan(joints_px).any():
            return np.full(2, np.nan), np.nan
        return square_box(joints_px, self.gamma)


TIGHT_BOX: Final = AroundHand()
"""The paper's mean expansion without noise."""


@dataclass(frozen=True, eq=False)
class AroundPoint:
    """A box around a point in the world, such as the root that an earlier round found.

    Attributes:
        center_world_mm: What each window is centred on.
        radius_mm: Half of what a window spans at the depth of the point.
    """

    center_world_mm: Float64[np.ndarray, "3"]
    radius_mm: float

    def windows(
        self, cameras: Sequence[Camera], joints_world_mm: Float64[np.ndarray, "joint=21 3"], rng: np.random.Generator
    ) -> Windows:
        """Return the windows; a view has none where the point lies behind the camera."""
        centers = np.stack([camera.project(self.center_world_mm) for camera in cameras])
        depths = np.array([float(camera.depth_mm(self.center_world_mm)) for camera in cameras])
        depths[np.isnan(centers).any(axis=-1)] = np.nan
        return Windows(centers, 2 * self.radius_mm * np.array([camera.fx_px for camera in cameras]) / depths)
