"""The head looks down at the hands, and sometimes elsewhere."""

from collections.abc import Mapping

import numpy as np
import pytest

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.synthetic.gaze import Gaze, Glance
from assemblyhands_core.synthetic.person import SIDE, Posture, Subject, sit

SUBJECT = Subject.from_seed(1)
QUIET = Gaze(tuple((0.0,) * 4 for _ in range(3)), ())


def seated(z_mm: float) -> tuple[Posture, Mapping[Hand, np.ndarray]]:
    places = {hand: np.array([60.0, 130.0, z_mm + 80.0 * SIDE[hand]]) for hand in HANDS}
    wrists = {hand: transforms.rigid(np.eye(3), places[hand]) for hand in HANDS}
    return sit(SUBJECT, wrists, places), places


def ahead(gaze: Gaze, t_s: float, z_mm: float = 80.0) -> np.ndarray:
    return gaze.T_headset_from_world(t_s, *seated(z_mm))[2, :3]


def test_the_face_turns_ahead_and_down_and_follows_the_hands() -> None:
    straight, right = ahead(QUIET, 0.0), ahead(QUIET, 0.0, z_mm=230.0)
    assert straight[0] > 0.8 and -0.7 < straight[1] < -0.25 and abs(straight[2]) < 0.05
    assert right[2] > straight[2] + 0.1


def test_the_head_is_above_the_neck_and_upright() -> None:
    posture, places = seated(80.0)
    pose = QUIET.T_headset_from_world(0.0, posture, places)
    head = transforms.inverse(pose)[:3, 3]
    assert 90.0 < head[1] - posture.neck_mm[1] < 160.0
    assert pose[1, 1] < -0.7  # y of the headset points down


def test_a_glance_turns_the_head_and_brings_it_back() -> None:
    glance = Glance(1.0, 3.0, (100.0, 200.0, 500.0))
    assert [glance.share(t) for t in (0.9, 2.0, 3.1)] == [0.0, 1.0, 0.0]
    gaze = Gaze(QUIET.phases_rad, (glance,))
    assert ahead(gaze, 2.0)[2] > ahead(QUIET, 2.0)[2] + 0.3
    assert ahead(gaze, 4.0).tolist() == ahead(QUIET, 4.0).tolist()


def test_people_look_elsewhere_about_twice_a_minute() -> None:
    glances = [len(Gaze.from_rng(np.random.default_rng(seed), 60.0).glances) for seed in range(200)]
    assert np.mean(glances) == pytest.approx(60.0 / 27.0, abs=0.4)
