"""Joints that people hold."""

from typing import Any

import numpy as np
import pyarrow as pa
from round_scene import KEYS, TRUE_MM, KnownAnswer, Scene, joints_table, names_of, points_of, truth_moved

from assemblyhands_core.data.catalog import CORRECTIONS
from assemblyhands_core.hands.joints import JOINT_NAMES


def _corrections(scene: Scene, key: tuple[int, str], joints: tuple[int, ...], num_views: int) -> pa.Table:
    """What people would set: the truth, in the first views."""
    rows = [
        names_of(key, camera_id=camera.camera_id, joint=JOINT_NAMES[joint], visibility=2, weight=10.0)
        | {"corrected_px": camera.project(TRUE_MM[key][joint])}
        for camera in scene.cameras[:num_views]
        for joint in joints
    ]
    return CORRECTIONS.from_rows(rows)


def test_joints_that_people_hold_stay_where_they_are(run: Any, scene: Scene) -> None:
    """The network is 3 mm off; of one hand, two joints were set in two views, and one in a single view."""
    both = _corrections(scene, KEYS[1], (2, 20), 2)
    given = {"corrections": pa.concat_tables([both, _corrections(scene, KEYS[1], (7,), 1)])}
    tables = run(KnownAnswer(truth_moved(1.0, 2.0, 2.0)), given)
    for key, row, detail in zip(KEYS, tables["joints"], tables["rounds"], strict=True):
        expected = TRUE_MM[key] + (1.0, 2.0, 2.0)
        if key == KEYS[1]:
            expected[[2, 20]] = TRUE_MM[key][[2, 20]]
        np.testing.assert_allclose(points_of(row), expected, atol=1e-3)
        assert row["source"] == ("manual" if key == KEYS[1] else "mvexonet")
        assert (f"corrected in one view, two hold a joint: {JOINT_NAMES[7]}" == detail["note"]) == (key == KEYS[1])
        assert detail["kept_round"] == 1


def test_held_joints_survive_a_network_that_is_not_sure_and_one_that_is_not_believed(run: Any, scene: Scene) -> None:
    corrections = {"corrections": _corrections(scene, KEYS[0], (4,), 2)}
    for network in (KnownAnswer(truth_moved(), confidence=0.01), KnownAnswer(truth_moved(500.0, 0.0, 0.0))):
        first = run(network, corrections)["joints"][0]
        np.testing.assert_allclose(points_of(first)[4], TRUE_MM[KEYS[0]][4], atol=1e-3)
        assert first["valid"][4] and first["source"] == "manual" and first["num_views"][4] == 4


def test_a_joint_that_could_not_be_triangulated_is_not_held(run: Any, scene: Scene) -> None:
    given = {"corrections": _corrections(scene, KEYS[0], (4,), 2), "triangulated": joints_table(missing=(4,))}
    first = run(KnownAnswer(truth_moved(1.0, 2.0, 2.0)), given)["joints"][0]
    np.testing.assert_allclose(points_of(first), TRUE_MM[KEYS[0]] + (1.0, 2.0, 2.0), atol=1e-3)
    assert first["source"] == "mvexonet"


def test_a_corrected_hand_that_was_kept_is_asked_again(run: Any, scene: Scene) -> None:
    """Joints that did not move, as their round was not believed, have not converged."""
    kept = joints_table(1, source="manual")
    earlier = {"joints": kept, "earlier_joints": joints_table(0), "corrections": _corrections(scene, KEYS[0], (4,), 2)}
    reasons = [row["reason"] for row in run(KnownAnswer(truth_moved()), earlier, stop_below_mm=1.0)["rounds"]]
    assert set(reasons) == {""}
