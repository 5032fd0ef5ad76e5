"""The four cameras on the headset.

Headset frame, mm: origin at the middle of the head (between the ears), x to the wearer's right, y down, z ahead. So
`mounts.look_at(head_center, what_the_face_turns_to, up)` is a pose `T_headset_from_world`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from assemblyhands_core.data.assemblyhands import EGO_SIZE_PX
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.lens_draws import draw_fisheye_lens
from assemblyhands_core.synthetic.mounts import disturbed, look_at

# ego1..ego4 of the two headsets that recorded Assembly101 (formats 1.2).
HEADSETS: Final[tuple[tuple[str, ...], ...]] = (
    ("HMC_84346135_mono10bit", "HMC_84347414_mono10bit", "HMC_84355350_mono10bit", "HMC_84358933_mono10bit"),
    ("HMC_21176875_mono10bit", "HMC_21176623_mono10bit", "HMC_21110305_mono10bit", "HMC_21179183_mono10bit"),
)

_HEADSET_UP: Final = np.array([0.0, -1.0, 0.0])
_MAX_DAY_SHIFT_MM: Final = 2.0
_MAX_DAY_TURN_DEG: Final = 0.3


@dataclass(frozen=True)
class _Mount:
    """A place on the visor; yaw is to the wearer's right, pitch up, roll as the sensor is built in."""

    center_mm: tuple[float, float, float]
    yaw_deg: float
    pitch_deg: float
    roll_deg: float


# Two cameras look out to the sides and a little up, one of them upside down; two look down at the hands, both lying on
# their side, so that image up points to the wearer's left. The real headsets are built like this.
_MOUNTS: Final = (
    _Mount((-74.0, -30.0, 92.0), -50.0, 22.0, 0.0),
    _Mount((74.0, -30.0, 92.0), 50.0, 22.0, 180.0),
    _Mount((57.0, 42.0, 96.0), 9.0, -36.0, -90.0),
    _Mount((-57.0, 42.0, 96.0), -9.0, -36.0, -90.0),
)


def headset_cameras(camera_ids: tuple[str, ...], studio_seed: int, day_seed: int) -> dict[str, Camera]:
    """Return the four cameras of a headset; their pose is `T_camera_from_headset`.

    Intrinsics belong to the camera and never change; the mounts differ by at most 2 mm and 0.3° from day to day.

    Args:
        camera_ids: ego1..ego4.
        studio_seed: Decides on the lenses.
        day_seed: Decides on the day's calibration.
    """
    return {
        camera_id: _ego_camera(camera_id, mount, studio_seed, day_seed)
        for camera_id, mount in zip(camera_ids, _MOUNTS, strict=True)
    }


def _ego_camera(camera_id: str, mount: _Mount, studio_seed: int, day_seed: int) -> Camera:
    rng = np.random.default_rng([studio_seed, *camera_id.encode()])
    day = np.random.default_rng([studio_seed, day_seed, *camera_id.encode()])
    yaw, pitch, roll = np.radians((mount.yaw_deg, mount.pitch_deg, mount.roll_deg))
    center = np.array(mount.center_mm)
    ahead = np.array([np.sin(yaw) * np.cos(pitch), -np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    nominal = look_at(center, center + ahead, _HEADSET_UP, float(roll))
    fx_px = rng.uniform(190.2, 193.2)
    return Camera(
        camera_id=camera_id,
        width_px=EGO_SIZE_PX[0],
        height_px=EGO_SIZE_PX[1],
        fx_px=fx_px,
        fy_px=fx_px + rng.uniform(-0.25, 0.25),
        cx_px=rng.uniform(312.0, 322.0),
        cy_px=rng.uniform(234.0, 240.0),
        lens=draw_fisheye_lens(rng),
        T_camera_from_world=disturbed(nominal, _MAX_DAY_SHIFT_MM, _MAX_DAY_TURN_DEG, day),
    )
