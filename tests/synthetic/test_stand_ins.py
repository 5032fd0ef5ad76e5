"""Stand-in keypoints are the true ones, off by as much as stated, and hidden joints are told by low confidence."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.data.ground_truth import TrueInstant
from assemblyhands_core.data.studio_tables import STAND_IN_BODIES, STAND_IN_HANDS
from assemblyhands_core.hands.body import BODY_KEYPOINT_NAMES
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.rig import assembly_rig
from assemblyhands_core.synthetic.session import Shot
from assemblyhands_core.synthetic.stand_ins import (
    BODY_NOISE_PX,
    HIDDEN_NOISE,
    MIN_JOINTS,
    VISIBLE_NOISE,
    stand_in_bodies,
    stand_in_hands,
)
from assemblyhands_core.synthetic.take import State

NAME = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"


@pytest.fixture(scope="module")
def shots(states: list[State]) -> list[Shot]:
    """Every tenth frame, in which all finger joints of even number are hidden."""
    rig, seen = assembly_rig(1), np.tile(np.arange(21) % 2 == 1, (2, 1))
    found = []
    for frame, state in list(enumerate(states))[::10]:
        cameras = rig.cameras_at(state.T_headset_from_world)
        joints = state.joints_world_mm.reshape(2, 21, 3)
        truth = TrueInstant(frame, joints, cameras, dict.fromkeys(cameras, seen))
        found.append(Shot({}, state, truth))
    return found


def errors(shots: list[Shot]) -> Iterator[tuple[Any, Any, Any]]:
    """Yield, for each hand in a view, errors as shares of the hand's size, confidence, and what is in the picture."""
    for shot in shots:
        for row in stand_in_hands(NAME, shot):
            camera, hand = shot.truth.cameras[row["camera"]], HANDS.index(row["hand"])
            true = camera.project(shot.truth.joints_world_mm[hand])
            side = float(np.ptp(true, axis=0).max())
            yield (row["keypoints_px"].reshape(21, 2) - true) / side, row["confidence"], camera.contains(true)


def test_hands_are_off_by_as_much_as_stated(shots: list[Shot]) -> None:
    off, confidence, inside = (np.stack(values) for values in zip(*errors(shots), strict=True))
    assert off[:, 1::2].std() == pytest.approx(VISIBLE_NOISE, rel=0.1)
    within = np.abs(off[:, ::2]) < 4 * HIDDEN_NOISE
    assert 0.9 < within.mean() < 0.995  # some are grossly wrong
    assert np.median(np.abs(off[:, ::2])) == pytest.approx(0.6745 * HIDDEN_NOISE, rel=0.2)
    assert confidence[:, 1::2][inside[:, 1::2]].mean() > confidence[:, ::2][inside[:, ::2]].mean() + 0.2
    assert (confidence[~inside] == 0).all() and (inside.sum(axis=1) >= MIN_JOINTS).all()


def test_bodies_are_where_the_arms_are_and_have_no_legs(shots: list[Shot]) -> None:
    wrist, knee = BODY_KEYPOINT_NAMES.index("left_wrist"), BODY_KEYPOINT_NAMES.index("left_knee")
    off = []
    for shot in shots:
        for row in stand_in_bodies(NAME, shot):
            pixels, confidence = row["keypoints_px"].reshape(17, 2), row["confidence"]
            true = shot.truth.cameras[row["camera"]].project(shot.state.posture.wrists_mm["left"])
            off.append(pixels[wrist] - true)
            assert confidence[wrist] >= 0.7 and confidence[knee] == 0
    assert np.std(off) == pytest.approx(BODY_NOISE_PX, rel=0.15) and abs(np.mean(off)) < 1.0


def test_only_fixed_cameras_have_them_and_they_repeat(shots: list[Shot]) -> None:
    tables = [
        spec.from_rows([row for shot in part for row in make(NAME, shot)])
        for spec, make in ((STAND_IN_HANDS, stand_in_hands), (STAND_IN_BODIES, stand_in_bodies))
        for part in (shots, shots[3:4])
    ]
    assert set(tables[0]["camera"].to_pylist()) == set(assembly_rig(1).exo)
    for whole, alone in (tables[:2], tables[2:]):
        frame = shots[3].truth.frame
        assert whole.filter(np.array(whole["frame"]) == frame).equals(alone)
