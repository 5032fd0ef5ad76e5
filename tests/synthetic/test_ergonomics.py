"""Discomfort: natural poses are cheap, contortions dear, left and right alike."""

import numpy as np
import pytest

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.ergonomics import discomfort
from assemblyhands_core.synthetic.person import SIDE, Subject
from assemblyhands_core.synthetic.presenting import natural_rotation

SUBJECT = Subject.from_seed(1)


def test_a_natural_pose_costs_little_and_a_twisted_one_much() -> None:
    for hand in HANDS:
        place = np.array([30.0, 150.0, 80.0 + SIDE[hand] * 100.0])
        natural = transforms.rigid(natural_rotation(hand), place)
        twisted = transforms.rigid(natural_rotation(hand) @ np.diag([-1.0, 1.0, -1.0]), place)
        backwards = transforms.rigid(natural_rotation(hand) @ np.diag([-1.0, -1.0, 1.0]), place)
        costs = discomfort(SUBJECT, hand, np.stack([natural, twisted, backwards]))
        assert costs[0] < 3.0 and costs[1] > 20.0 and costs[2] > 20.0


def test_left_and_right_cost_the_same() -> None:
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    place = np.array([30.0, 150.0, 180.0])
    right = transforms.rigid(natural_rotation("right"), place)
    left = mirror @ right @ np.diag([-1.0, 1.0, 1.0, 1.0])
    left[2, 3] = 160.0 - place[2]  # the person sits at z = 80
    costs = [discomfort(SUBJECT, "right", right), discomfort(SUBJECT, "left", left)]
    assert costs[0] == pytest.approx(costs[1])


def test_an_arm_stretched_too_far_or_an_elbow_under_the_table_costs() -> None:
    def cost(x: float, y: float) -> float:
        pose = transforms.rigid(natural_rotation("right"), np.array([x, y, 180.0]))
        return float(discomfort(SUBJECT, "right", pose))

    assert cost(420.0, 150.0) > cost(60.0, 150.0) + 5.0
    assert cost(150.0, -60.0) > cost(150.0, 120.0)
