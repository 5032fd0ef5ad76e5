"""Boxes: the paper's expansion, its noise, balls around points."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.synthetic.crop_boxes import AroundHand, AroundPoint, Windows

# A hand of 100 × 60 mm at 500 mm: 200 × 120 px at a focal length of 1000 px.
JOINTS_MM = np.array([[-50.0, -30.0, 500.0], *[[0.0, 0.0, 500.0]] * 19, [50.0, 30.0, 500.0]])
AHEAD = Camera("ahead", 1000, 800, 1000.0, 1000.0, 499.5, 399.5, Pinhole(), np.eye(4))
BEHIND = AHEAD.moved(np.diag([-1.0, 1.0, -1.0, 1.0]))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_expansion_is_that_of_the_paper() -> None:
    found = AroundHand(1.5).windows([AHEAD, BEHIND], JOINTS_MM, rng())
    assert_allclose(found.centers_px[0], [499.5, 399.5])
    assert found.sides_px[0] == pytest.approx(1.5 * 200.0)
    assert np.isnan(found.sides_px[1]) and np.isnan(found.centers_px[1]).all()


def test_noise_has_the_stated_spread_and_differs_between_views() -> None:
    found = AroundHand(1.5, gamma_spread=0.1, center_spread=0.05).windows([AHEAD] * 2000, JOINTS_MM, rng(3))
    assert np.log(found.sides_px / 300.0).mean() == pytest.approx(0.0, abs=0.01)
    assert np.log(found.sides_px / 300.0).std() == pytest.approx(0.1, rel=0.1)
    errors = (found.centers_px - (499.5, 399.5)) / found.sides_px[:, None]
    assert_allclose(errors.std(axis=0), 0.05, rtol=0.1)
    again = AroundHand(1.5, gamma_spread=0.1, center_spread=0.05).windows([AHEAD] * 2000, JOINTS_MM, rng(3))
    assert again.centers_px.tobytes() == found.centers_px.tobytes()


def test_a_ball_around_a_point_spans_twice_its_radius() -> None:
    found = AroundPoint(np.array([100.0, 0.0, 500.0]), 80.0).windows([AHEAD, BEHIND], JOINTS_MM, rng())
    assert_allclose(found.centers_px[0], [699.5, 399.5])
    assert found.sides_px[0] == pytest.approx(160.0 * 1000 / 500)
    assert np.isnan(found.sides_px[1])


def test_given_windows_are_taken_as_they_are_or_refused() -> None:
    given = Windows(np.zeros((2, 2)), np.ones(2))
    assert given.windows([AHEAD, BEHIND], JOINTS_MM, rng()) is given
    with pytest.raises(ValueError, match="2 windows are given for 1 cameras"):
        given.windows([AHEAD], JOINTS_MM, rng())
