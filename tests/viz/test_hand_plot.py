import matplotlib.pyplot as plt
import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.geometry.transforms import rigid
from assemblyhands_core.hands.joints import BONES, ROOT, Hand
from assemblyhands_core.viz.hand_plot import frame_hands, plot_hand, seen_from

# It looks along the world's x from 1 m before the origin; up in its picture is the world's z.
ROTATION = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
CAMERA = Camera("front", 640, 480, 500.0, 500.0, 320.0, 240.0, Pinhole(), rigid(ROTATION, np.array([0, 0, 1000.0])))
HAND = np.random.default_rng(0).normal(scale=40.0, size=(21, 3))


def test_axes_are_right_away_and_up_in_the_picture() -> None:
    np.testing.assert_allclose(seen_from(CAMERA, np.array([[10.0, 20.0, 30.0]])), [[-20.0, 1010.0, 30.0]])


@pytest.mark.parametrize(("hand", "style"), [("right", "-"), ("left", "--")])
def test_every_bone_whose_ends_are_known_is_drawn(hand: Hand, style: str) -> None:
    axes = plt.figure().add_subplot(projection="3d")
    joints = HAND.copy()
    joints[ROOT] = np.nan
    plot_hand(axes, joints, hand, CAMERA)
    lines = [np.array(line.get_data_3d()) for line in axes.get_lines()]
    assert {line.get_linestyle() for line in axes.get_lines()} == {style}
    known = [line for line in lines if np.isfinite(line).all()]
    assert len(lines) == len(BONES) and len(known) == len(BONES) - 2
    child, parent = BONES[0]
    np.testing.assert_allclose(lines[0].T, seen_from(CAMERA, HAND[[child, parent]]))
    assert len(axes.collections[0].get_offsets()) == 20
    plt.close(axes.figure)


def test_all_axes_have_one_scale_and_hold_everything() -> None:
    axes = plt.figure().add_subplot(projection="3d")
    frame_hands(axes, np.concatenate([HAND, np.full((1, 3), np.nan)]), CAMERA)
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    sides = limits[:, 1] - limits[:, 0]
    np.testing.assert_allclose(sides, sides[0])
    points = seen_from(CAMERA, HAND)
    assert (points > limits[:, 0]).all() and (points < limits[:, 1]).all()
    frame_hands(axes, np.full((2, 3), np.nan), CAMERA)  # nothing known: no warning, some box
    plt.close(axes.figure)
