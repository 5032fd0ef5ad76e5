"""What evaluation may read: joints of both hands, what every view sees of them, and how much is hidden."""

from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.ground_truth import (
    GROUND_TRUTH,
    TRUE_INSTANTS,
    TRUE_JOINTS,
    TRUE_VIEWS,
    TrueInstant,
    ground_truth_tables,
    read_ground_truth,
    write_ground_truth,
)
from assemblyhands_core.data.tables import TableError
from assemblyhands_core.synthetic.mounts import look_at
from assemblyhands_core.synthetic.rig import WORK_CENTER_WORLD_MM, Rig, assembly_rig, desktop_rig

HEAD = look_at(np.array([-190.0, 520.0, 80.0]), np.array([110.0, 310.0, 80.0]), np.array([0.0, 1.0, 0.0]))


def _instant(rig: Rig, frame: int = 0, headset: np.ndarray | None = HEAD) -> TrueInstant:
    rng = np.random.default_rng(frame)
    joints = WORK_CENTER_WORLD_MM + rng.uniform(-90, 90, (2, 21, 3))
    cameras = rig.cameras_at(HEAD)
    unoccluded = {name: rng.random((2, 21)) < 0.75 for name in cameras}
    return TrueInstant(frame, joints, cameras, unoccluded, headset, "screw", "bolt")


def test_joints_are_right_then_left_and_read_back(tmp_path: Path) -> None:
    instants = [_instant(assembly_rig(1), frame) for frame in range(3)]
    tables = ground_truth_tables("s", instants)
    write_ground_truth(tmp_path, tables)
    read = read_ground_truth(tmp_path, TRUE_JOINTS)
    assert read.column("hand").to_pylist() == ["right", "left"] * 3
    joints = to_numpy(read.column("joints_world_mm")).reshape(3, 2, 21, 3)
    assert np.abs(joints - [instant.joints_world_mm for instant in instants]).max() < 1e-4
    assert all(read_ground_truth(tmp_path, spec).equals(tables[spec.name]) for spec in GROUND_TRUTH)


def test_views_hold_the_true_projections_and_hidden_joints() -> None:
    instant = _instant(assembly_rig(1))
    views = ground_truth_tables("s", [instant])[TRUE_VIEWS.name].to_pylist()
    assert len(views) == 2 * 12
    row = next(row for row in views if (row["camera_id"], row["hand"]) == ("C10118_rgb", "left"))
    pixels = instant.cameras["C10118_rgb"].project(instant.joints_world_mm[1])
    assert np.abs(np.reshape(row["joints_px"], (21, 2)) - pixels).max() < 1e-3
    assert all(row["is_in_image"]) and row["is_visible"] == instant.is_unoccluded["C10118_rgb"][1].tolist()
    assert row["occlusion_rate"] == pytest.approx(1 - np.mean(row["is_visible"]), abs=1e-6)


def test_a_joint_outside_the_image_is_neither_visible_nor_hidden() -> None:
    instant = _instant(assembly_rig(1))
    instant.joints_world_mm[0, 3] = (90.0, 150.0, 2500.0)  # far to the side: no exocentric camera but the one there
    row = next(
        row for row in ground_truth_tables("s", [instant])[TRUE_VIEWS.name].to_pylist()
        if (row["camera_id"], row["hand"]) == ("C10118_rgb", "right")
    )  # fmt: skip
    assert not row["is_in_image"][3] and not row["is_visible"][3]
    expected = 1 - np.sum(row["is_visible"]) / 20
    assert row["occlusion_rate"] == pytest.approx(expected, abs=1e-6)


def test_rates_of_an_instant_pool_its_views() -> None:
    instant = _instant(assembly_rig(1))
    tables = ground_truth_tables("s", [instant])
    (row,) = tables[TRUE_INSTANTS.name].to_pylist()
    views = tables[TRUE_VIEWS.name].to_pylist()
    for name, is_ego in (("exo", False), ("ego", True)):
        chosen = [view for view in views if view["camera_id"].startswith("HMC_") == is_ego]
        in_image, visible = (sum(sum(view[column]) for view in chosen) for column in ("is_in_image", "is_visible"))
        assert in_image > 50
        assert row[f"{name}_occlusion_rate"] == pytest.approx(1 - visible / in_image, abs=1e-6)
    assert (row["verb"], row["noun"]) == ("screw", "bolt")
    assert (np.reshape(row["T_headset_from_world"], (4, 4)) == HEAD).all()


def test_without_headset_there_is_no_egocentric_rate() -> None:
    (row,) = ground_truth_tables("s", [_instant(desktop_rig(1), headset=None)])[TRUE_INSTANTS.name].to_pylist()
    assert np.isnan(row["ego_occlusion_rate"]) and 0 < row["exo_occlusion_rate"] < 1
    assert np.isnan(row["T_headset_from_world"]).all()


def test_another_table_is_refused(tmp_path: Path) -> None:
    write_ground_truth(tmp_path, ground_truth_tables("s", [_instant(desktop_rig(1), headset=None)]))
    (tmp_path / "true_joints.parquet").write_bytes((tmp_path / "true_instants.parquet").read_bytes())
    with pytest.raises(TableError, match="holds table true_instants v1, wanted true_joints v1"):
        read_ground_truth(tmp_path, TRUE_JOINTS)
