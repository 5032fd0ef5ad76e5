"""Drawn lenses: of the real magnitude, one-to-one where it matters, other ones for other seeds."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.synthetic.lens_draws import draw_fisheye_lens, draw_perspective_lens

SEEDS = st.integers(0, 2**32)


@given(seed=SEEDS)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_barrel_distortion(seed: int) -> None:
    lens = draw_perspective_lens(np.random.default_rng(seed))
    assert -0.137 < lens.k1 < -0.122 and 0.09 < lens.k2 < 0.16 and abs(lens.k3) < 0.05
    assert (lens.k4, lens.k5, lens.k6) == (0, 0, 0)
    corner = lens.distort(np.array([0.78, 0.44, 1.0]))
    shrink = np.linalg.norm(corner) / np.hypot(0.78, 0.44)
    assert 0.96 < shrink < 0.974
    assert np.abs(lens.distort(lens.undistort(corner)) - corner).max() < 1e-12


@given(seed=SEEDS)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_fisheye_grows_up_to_180_degrees_and_follows_its_curve(seed: int) -> None:
    lens = draw_fisheye_lens(np.random.default_rng(seed))
    k = np.array([1.0, lens.k1, lens.k2, lens.k3, lens.k4, lens.k5, lens.k6])
    angles = np.linspace(0, np.pi, 2000)
    radii = angles * np.polynomial.polynomial.polyval(angles**2, k)
    assert (np.diff(radii) > 0).all()
    # Between the curves of the least and the largest parameters, and what the fit may miss.
    for degrees, low, high in ((45, 1.149, 1.163), (75, 1.270, 1.298), (88, 1.345, 1.405)):
        stretch = np.interp(np.radians(degrees), angles, radii) / np.radians(degrees)
        assert low < stretch < high
    assert 0.24 < lens.k1 < 0.28 and 0.014 < lens.k6 < 0.020


def test_seeds_decide() -> None:
    lenses = [draw_fisheye_lens(np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert lenses[0] == lenses[1] != lenses[2]
