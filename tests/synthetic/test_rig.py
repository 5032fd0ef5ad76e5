"""The studio's rigs: magnitudes of the real ones, a calibration of their own every day, hands in every view."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry import transforms
from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.synthetic.headset import HEADSETS
from assemblyhands_core.synthetic.mounts import look_at
from assemblyhands_core.synthetic.rig import (
    RIGS,
    TABLE_TOP_Y_MM,
    WORK_CENTER_WORLD_MM,
    WORK_RADIUS_MM,
    Rig,
    RigKind,
    assembly_rig,
    desktop_rig,
)

WORK_CENTER = np.array(WORK_CENTER_WORLD_MM)
UP = np.array([0.0, 1.0, 0.0])
HEAD = look_at(np.array([-190.0, 520.0, 80.0]), np.array([110.0, 310.0, 80.0]), UP)
EXO_SERIALS = ["C10095", "C10115", "C10118", "C10119", "C10379", "C10390", "C10395", "C10404"]
DAYS = st.integers(0, 99_991_231)


def _outline_of_ball(camera: Camera, center: np.ndarray, radius: float) -> np.ndarray:
    """Return world points on the circle in which a camera sees a ball end."""
    towards = center - camera.center_world_mm
    distance = float(np.linalg.norm(towards))
    across = np.cross(towards, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across)
    upright = np.cross(towards / distance, across)
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)[:, None]
    foot = center - towards * (radius / distance) ** 2
    return foot + radius * np.sqrt(1 - (radius / distance) ** 2) * (np.cos(turn) * across + np.sin(turn) * upright)


@given(day=DAYS)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_eight_cameras_of_the_stated_magnitudes_stand_around_the_table(day: int) -> None:
    exo = assembly_rig(day).exo
    assert list(exo) == [f"{serial}_rgb" for serial in EXO_SERIALS]
    for camera in exo.values():
        assert (camera.width_px, camera.height_px, camera.lens.model) == (1920, 1080, "OpenCV")
        assert 1190 <= camera.fx_px <= 1250 and 1189 <= camera.fy_px <= 1251
        assert 700 <= np.linalg.norm(camera.center_world_mm - WORK_CENTER) <= 1300
        assert camera.center_world_mm[1] > TABLE_TOP_Y_MM + 20


@given(day=DAYS, kind=st.sampled_from(["assembly", "desktop"]))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_every_exocentric_camera_sees_the_whole_work_volume(day: int, kind: RigKind) -> None:
    for camera in RIGS[kind](day).exo.values():
        assert camera.contains(camera.project(_outline_of_ball(camera, WORK_CENTER, WORK_RADIUS_MM))).all()


@given(day=DAYS)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_four_fisheyes_sit_on_the_visor(day: int) -> None:
    ego = assembly_rig(day).ego
    assert tuple(ego) in HEADSETS
    for camera in ego.values():
        assert (camera.width_px, camera.height_px, camera.lens.model) == (636, 480, "OVFishEye62")
        assert 190 <= camera.fx_px <= 194 and 189.5 <= camera.fy_px <= 194
        assert 100 <= np.linalg.norm(camera.center_world_mm) <= 200
        assert camera.center_world_mm[2] > 80  # in front of the face


def test_both_headsets_are_worn() -> None:
    worn = [tuple(assembly_rig(day).ego) for day in range(60)]
    assert 5 <= worn.count(HEADSETS[0]) <= 25
    assert worn.count(HEADSETS[0]) + worn.count(HEADSETS[1]) == 60


@pytest.mark.parametrize("make", [assembly_rig, desktop_rig])
def test_a_day_has_one_calibration_and_another_day_another(make: Callable[[int], Rig]) -> None:
    first, again, other = make(20220302), make(20220302), make(20220303)
    for name, camera in first.exo.items():
        assert camera.T_camera_from_world.tobytes() == again.exo[name].T_camera_from_world.tobytes()
        assert (camera.K == again.exo[name].K).all()
        moved_mm = np.linalg.norm(camera.center_world_mm - other.exo[name].center_world_mm)
        assert 1 < moved_mm < 90
        assert 0 < abs(camera.fx_px - other.exo[name].fx_px) <= 4
        assert (camera.lens.coefficients() == other.exo[name].lens.coefficients()).all()


def test_headset_lenses_never_change_and_mounts_hardly() -> None:
    days = [rig.ego for rig in map(assembly_rig, range(80)) if tuple(rig.ego) == HEADSETS[1]]
    for name in HEADSETS[1]:
        cameras = [ego[name] for ego in days]
        assert len({(c.fx_px, c.cx_px, *c.lens.coefficients()) for c in cameras}) == 1
        spread_mm = np.std([c.center_world_mm for c in cameras], axis=0)
        assert (spread_mm > 0.3).all() and (spread_mm < 2.3).all()


@pytest.mark.parametrize("day", [20220302, 20220303])
def test_ego_lenses_are_one_to_one_over_the_whole_image(day: int) -> None:
    x, y = np.meshgrid(np.append(np.arange(-0.5, 636, 7.0), 635.5), np.append(np.arange(-0.5, 480, 7.0), 479.5))
    pixels = np.stack((x, y), axis=-1)
    for camera in assembly_rig(day).ego.values():
        rays = camera.unproject_camera(pixels)
        assert np.abs(camera.project_camera(rays) - pixels).max() < 1e-9
        corners = np.degrees(np.arccos(rays[[0, 0, -1, -1], [0, -1, 0, -1], 2]))
        assert (corners > 84).all() and (corners < 90).all()


def test_ego_cameras_move_with_the_headset() -> None:
    rig = assembly_rig(20220302)
    point_headset = np.array([30.0, 200.0, 300.0])
    point_world = transforms.apply(transforms.inverse(HEAD), point_headset)
    for name, camera in rig.ego_at(HEAD).items():
        assert np.abs(camera.project(point_world) - rig.ego[name].project(point_headset)).max() < 1e-9
        in_world = transforms.apply(transforms.inverse(HEAD), rig.ego[name].center_world_mm)
        assert np.abs(camera.center_world_mm - in_world).max() < 1e-9


def test_the_lower_cameras_see_the_hands_and_the_outer_ones_the_sides() -> None:
    left, right, right_down, left_down = assembly_rig(20220302).ego_at(HEAD).values()
    for camera in (right_down, left_down):
        assert camera.contains(camera.project(_outline_of_ball(camera, WORK_CENTER, 150.0))).all()
        assert camera.T_camera_from_world[1, 2] > 0.8  # image down is +z, the wearer's right
    assert left.T_camera_from_world[2, 2] < -0.6 and right.T_camera_from_world[2, 2] > 0.6  # the right is +z
    assert left.T_camera_from_world[1, 1] < -0.6 and right.T_camera_from_world[1, 1] > 0.6  # the right one upside down


def test_all_cameras_of_an_instant() -> None:
    rig = assembly_rig(1)
    assert list(rig.cameras_at(HEAD)) == [*rig.exo, *rig.ego]


def test_the_desktop_rig_is_another_one() -> None:
    desktop, assembly = desktop_rig(5), assembly_rig(5)
    assert len(desktop.exo) == 12 and not desktop.ego and desktop.ego_at(HEAD) == {}
    assert all((camera.width_px, camera.height_px) == (1920, 1080) for camera in desktop.exo.values())
    ours = np.array([camera.center_world_mm for camera in desktop.exo.values()])
    theirs = np.array([camera.center_world_mm for camera in assembly.exo.values()])
    assert np.linalg.norm(ours[:, None] - theirs, axis=-1).min() > 60


def test_the_headset_alone_is_the_days_own() -> None:
    alone, whole = RIGS["headset"](5), assembly_rig(5)
    assert not alone.exo and list(alone.ego) == list(whole.ego)
    for camera_id, camera in alone.ego.items():
        np.testing.assert_array_equal(camera.T_camera_from_world, whole.ego[camera_id].T_camera_from_world)


def test_distortion_has_the_size_of_the_real_cameras(calibration_dir: Path) -> None:
    real = [c for path in sorted(calibration_dir.glob("*.json")) for c in load_assembly101_calibration(path).values()]
    ours = [camera for day in range(8) for camera in assembly_rig(day).cameras_at(HEAD).values()]
    for model, used in (("OpenCV", [0, 1]), ("OVFishEye62", [0, 1, 2, 3, 4, 5])):
        theirs, mine = (
            np.array([c.lens.coefficients() for c in cameras if c.lens.model == model]) for cameras in (real, ours)
        )
        ratio = mine[:, used].mean(axis=0) / theirs[:, used].mean(axis=0)
        assert (ratio > 0.7).all() and (ratio < 1.45).all()
        assert np.abs(mine[:, 2]).max() < 2 * np.abs(theirs[:, 2]).max()
        assert 0 < np.abs(mine[:, 6:8]).max() <= 1.1e-3
        assert not np.isin(mine[:, used], theirs).any()  # own numbers
