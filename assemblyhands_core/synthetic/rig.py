"""The camera rigs of the studio: where cameras stand around the table, and the lenses they have.

The studio's world: mm, +y up, the table top at y = TABLE_TOP_Y_MM. The person sits at negative x, faces +x and has the
right hand towards +z. Hands work around WORK_CENTER_WORLD_MM; every exocentric camera sees the whole ball of radius
WORK_RADIUS_MM around it. Source: paper, Sec. 3.1 and supplement (Assembly101's and Desktop Activities' rigs).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.headset import HEADSETS, headset_cameras
from assemblyhands_core.synthetic.lens_draws import draw_perspective_lens
from assemblyhands_core.synthetic.mounts import disturbed, look_at, spherical

RigKind = Literal["assembly", "desktop", "headset"]

TABLE_TOP_Y_MM: Final = -20.0
WORK_CENTER_WORLD_MM: Final = (80.0, 190.0, 80.0)
WORK_RADIUS_MM: Final = 220.0
EXO_SIZE_PX: Final = (1920, 1080)

_STUDIO_SEED: Final = 20230618
_UP_WORLD: Final = np.array([0.0, 1.0, 0.0])
_MAX_DAY_SHIFT_MM: Final = 25.0
_MAX_DAY_TURN_DEG: Final = 1.5
_MAX_DAY_ZOOM_PX: Final = 2.0
_MAX_DAY_CENTER_PX: Final = 1.5


@dataclass(frozen=True, eq=False)
class Rig:
    """The cameras of a recording.

    Attributes:
        kind: Which rig this is.
        exo: Cameras that stand still, by name.
        ego: Cameras on the headset, by name; their pose is `T_camera_from_headset` (frame: see `headset`).
    """

    kind: RigKind
    exo: Mapping[str, Camera]
    ego: Mapping[str, Camera]

    def ego_at(self, T_headset_from_world: Float[np.ndarray, "4 4"]) -> dict[str, Camera]:
        """Return the headset's cameras in the world, where the headset is at one instant."""
        return {
            camera_id: camera.moved(camera.T_camera_from_world @ T_headset_from_world)
            for camera_id, camera in self.ego.items()
        }

    def cameras_at(self, T_headset_from_world: Float[np.ndarray, "4 4"]) -> dict[str, Camera]:
        """Return all cameras in the world at one instant, those that stand still first."""
        return {**self.exo, **self.ego_at(T_headset_from_world)}


@dataclass(frozen=True)
class _Stand:
    """Where a camera stands as seen from the work volume's centre, and its focal length."""

    azimuth_deg: float
    elevation_deg: float
    distance_mm: float
    focal_px: float


_ASSEMBLY_STANDS: Final[Mapping[str, _Stand]] = {
    "C10095_rgb": _Stand(44.0, 39.0, 900.0, 1193.5),
    "C10115_rgb": _Stand(4.0, 86.0, 1010.0, 1245.0),
    "C10118_rgb": _Stand(-6.0, 4.0, 770.0, 1245.0),
    "C10119_rgb": _Stand(-38.0, 42.0, 830.0, 1245.0),
    "C10379_rgb": _Stand(-96.0, -7.0, 940.0, 1245.0),
    "C10390_rgb": _Stand(87.0, 46.0, 1140.0, 1245.0),
    "C10395_rgb": _Stand(101.0, -6.0, 990.0, 1245.0),
    "C10404_rgb": _Stand(-79.0, 49.0, 1080.0, 1245.0),
}
_DESKTOP_STANDS: Final[Mapping[str, _Stand]] = {
    "D01_rgb": _Stand(0.0, 17.0, 1150.0, 1120.0),
    "D02_rgb": _Stand(40.0, 20.0, 1100.0, 1120.0),
    "D03_rgb": _Stand(-40.0, 20.0, 1100.0, 1120.0),
    "D04_rgb": _Stand(80.0, 16.0, 1000.0, 1120.0),
    "D05_rgb": _Stand(-80.0, 16.0, 1000.0, 1120.0),
    "D06_rgb": _Stand(122.0, 24.0, 1050.0, 1120.0),
    "D07_rgb": _Stand(-122.0, 24.0, 1050.0, 1120.0),
    "D08_rgb": _Stand(20.0, 58.0, 880.0, 1060.0),
    "D09_rgb": _Stand(-20.0, 58.0, 880.0, 1060.0),
    "D10_rgb": _Stand(95.0, 55.0, 900.0, 1060.0),
    "D11_rgb": _Stand(-95.0, 55.0, 900.0, 1060.0),
    "D12_rgb": _Stand(175.0, 74.0, 960.0, 1060.0),
}


def assembly_rig(day_seed: int) -> Rig:
    """Return Assembly101's rig on a recording day: 8 RGB cameras on a scaffold and 4 monochrome ones on a headset.

    Lenses belong to the cameras; every day has its own calibration (poses, and focal lengths within 2 px) and one of
    the two headsets, the second on three days of four.

    Args:
        day_seed: The day, for example 20310502; not negative.
    """
    headset = HEADSETS[int(np.random.default_rng([_STUDIO_SEED, day_seed]).random() > 0.25)]
    return Rig("assembly", _exo_cameras(_ASSEMBLY_STANDS, day_seed), headset_cameras(headset, _STUDIO_SEED, day_seed))


def desktop_rig(day_seed: int) -> Rig:
    """Return the unseen rig of the paper's Desktop Activities on a day: 12 RGB cameras, placed differently, no headset.

    Args:
        day_seed: The day, for example 20310502; not negative.
    """
    return Rig("desktop", _exo_cameras(_DESKTOP_STANDS, day_seed), {})


def headset_rig(day_seed: int) -> Rig:
    """Return the headset alone, for recordings with labels that need no fixed cameras: a tenth of the pictures to draw.

    Args:
        day_seed: The day, for example 20310502; not negative.
    """
    return Rig("headset", {}, assembly_rig(day_seed).ego)


RIGS: Final[Mapping[RigKind, Callable[[int], Rig]]] = {
    "assembly": assembly_rig,
    "desktop": desktop_rig,
    "headset": headset_rig,
}


def _exo_cameras(stands: Mapping[str, _Stand], day_seed: int) -> dict[str, Camera]:
    return {camera_id: _exo_camera(camera_id, stand, day_seed) for camera_id, stand in stands.items()}


def _exo_camera(camera_id: str, stand: _Stand, day_seed: int) -> Camera:
    rng = np.random.default_rng([_STUDIO_SEED, *camera_id.encode()])
    day = np.random.default_rng([_STUDIO_SEED, day_seed, *camera_id.encode()])
    work_center = np.array(WORK_CENTER_WORLD_MM)
    center = work_center + stand.distance_mm * spherical(stand.azimuth_deg, stand.elevation_deg)
    zoom_px = day.uniform(-_MAX_DAY_ZOOM_PX, _MAX_DAY_ZOOM_PX)
    fx_px = stand.focal_px + rng.uniform(-1.5, 2.5) + zoom_px
    principal_px = np.array([959.5, 526.0]) + rng.uniform(-12.0, 12.0, 2)
    principal_px += day.uniform(-_MAX_DAY_CENTER_PX, _MAX_DAY_CENTER_PX, 2)
    return Camera(
        camera_id=camera_id,
        width_px=EXO_SIZE_PX[0],
        height_px=EXO_SIZE_PX[1],
        fx_px=fx_px,
        fy_px=fx_px + rng.uniform(-1.0, 1.0),
        cx_px=principal_px[0],
        cy_px=principal_px[1],
        lens=draw_perspective_lens(rng),
        T_camera_from_world=disturbed(
            look_at(center, work_center, _UP_WORLD), _MAX_DAY_SHIFT_MM, _MAX_DAY_TURN_DEG, day
        ),
    )
