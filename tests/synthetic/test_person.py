"""People: distinct subjects, arms of constant length, anatomical angles with the right signs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS, Hand
from assemblyhands_core.synthetic.person import (
    SIDE,
    Subject,
    elbow_mm,
    forearm_twist_rad,
    resting_shoulder_mm,
    sit,
    wrist_bend_rad,
)

SUBJECT = Subject.from_seed(1)


def facing(forward: tuple[float, float, float], back_of_hand: tuple[float, float, float]) -> np.ndarray:
    """A wrist at the origin of the world's axes: y as given, z out of the back of the hand."""
    y, z = np.array(forward, dtype=float), np.array(back_of_hand, dtype=float)
    return transforms.rigid(np.stack([np.cross(y, z), y, z], axis=-1), np.zeros(3))


def test_34_subjects_are_34_different_people() -> None:
    people = [Subject.from_seed(seed) for seed in range(34)]
    looks = {(p.sleeve, p.shirt, p.hair, p.watch, p.gloves, p.is_striped, p.dominant) for p in people}
    hands = {p.hand_shape.skeleton.phalanges_mm.tobytes() for p in people}
    assert len(hands) == 34 and len(looks) > 28
    assert {p.sleeve for p in people} == {"short", "half", "long"}
    assert 1 <= sum(p.dominant == "left" for p in people) <= 9
    assert 1 <= sum(p.gloves is not None for p in people) <= 10 and sum(p.watch is not None for p in people) >= 5
    assert np.ptp([p.hand_shape.tone.darkness for p in people]) > 0.6
    assert 0.88 <= min(p.scale for p in people) < 0.95 < 1.05 < max(p.scale for p in people) <= 1.12


def test_the_same_seed_is_the_same_person() -> None:
    one, same = Subject.from_seed(7), Subject.from_seed(7)
    assert one.hand_shape.skeleton.bases_mm.tobytes() == same.hand_shape.skeleton.bases_mm.tobytes()
    assert (one.shirt, one.scale, one.watch) == (same.shirt, same.scale, same.watch)


@settings(max_examples=80, derandomize=True, deadline=None)
@given(
    st.sampled_from(HANDS),
    st.tuples(st.floats(-150.0, 300.0), st.floats(-10.0, 350.0), st.floats(-300.0, 400.0)),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_bones_of_the_arm_keep_their_lengths(hand: Hand, place: tuple[float, ...], vector: tuple[float, ...]) -> None:
    other: Hand = "left" if hand == "right" else "right"
    wrists = {
        hand: transforms.rigid(facing((1, 0, 0), (0, 1, 0))[:3, :3], np.array(place)),
        other: transforms.rigid(np.eye(3), np.array([0.0, 100.0, 80.0 + 100.0 * SIDE[other]])),
    }
    posture = sit(SUBJECT, wrists, {h: wrists[h][:3, 3] for h in HANDS})
    upper = np.linalg.norm(posture.elbows_mm[hand] - posture.shoulders_mm[hand])
    fore = np.linalg.norm(posture.wrists_mm[hand] - posture.elbows_mm[hand])
    assert_allclose([upper, fore], [SUBJECT.upper_arm_mm, SUBJECT.forearm_mm], rtol=1e-9)


def test_elbows_hang_down_and_outwards() -> None:
    for hand in HANDS:
        shoulder = resting_shoulder_mm(SUBJECT, hand)
        wrist = np.array([40.0, 120.0, 80.0 + SIDE[hand] * 100.0])
        elbow = elbow_mm(SUBJECT, hand, shoulder, wrist, np.array([0.9, 0.0, -0.43 * SIDE[hand]]))
        middle = 0.5 * (shoulder + wrist)
        assert elbow[1] < middle[1] - 50.0 and (elbow[2] - middle[2]) * SIDE[hand] > 20.0


@pytest.mark.parametrize("hand", HANDS)
def test_palm_down_is_pronated_and_palm_up_supinated(hand: Hand) -> None:
    # Upper arm hanging, forearm ahead: the textbook pose, neutral with the thumb up.
    shoulder, elbow = np.array([-200.0, 300.0, 0.0]), np.array([-200.0, 0.0, 0.0])
    thumb_up = facing((1, 0, 0), (0, 0, SIDE[hand]))
    palm_down, palm_up = facing((1, 0, 0), (0, 1, 0)), facing((1, 0, 0), (0, -1, 0))
    twists = [forearm_twist_rad(hand, shoulder, elbow, pose) for pose in (thumb_up, palm_down, palm_up)]
    assert_allclose(np.degrees(twists), [0.0, 90.0, -90.0], atol=1e-9)


def test_wrist_angles_have_the_signs_of_anatomy() -> None:
    elbow = np.array([-200.0, 0.0, 0.0])
    flexed = facing((np.cos(0.4), -np.sin(0.4), 0.0), (np.sin(0.4), np.cos(0.4), 0.0))
    assert_allclose(wrist_bend_rad(elbow, flexed), [0.4, 0.0], atol=1e-12)
    # A right hand, palm down, that points to the left (-z, where its thumb is).
    radial = facing((np.cos(0.3), 0.0, -np.sin(0.3)), (0, 1, 0))
    assert_allclose(wrist_bend_rad(elbow, radial), [0.0, 0.3], atol=1e-12)


def test_the_trunk_leans_to_far_hands_and_the_shoulder_follows_a_hand_out_of_reach() -> None:
    def seated(x: float) -> tuple[float, float]:
        wrists = {h: transforms.rigid(np.eye(3), np.array([x, 60.0, 80.0 + 120.0 * SIDE[h]])) for h in HANDS}
        posture = sit(SUBJECT, wrists, {h: wrists[h][:3, 3] for h in HANDS})
        return posture.neck_mm[0], posture.shoulders_mm["right"][0]

    near, far, too_far = seated(0.0), seated(250.0), seated(420.0)
    assert far[0] > near[0] + 20.0
    assert too_far[1] - too_far[0] > far[1] - far[0] + 30.0
