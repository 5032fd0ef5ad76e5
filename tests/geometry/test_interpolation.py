import numpy as np

from assemblyhands_core.geometry.interpolation import fill_gaps


def _track(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)[:, None, None] * np.array([1.0, 2.0, 0.0])


def test_a_short_gap_is_filled_linearly_and_marked() -> None:
    filled, is_filled = fill_gaps(_track(3.0, np.nan, np.nan, 9.0), max_gap=2)
    np.testing.assert_allclose(filled, _track(3.0, 5.0, 7.0, 9.0))
    assert is_filled[:, 0].tolist() == [False, True, True, False]


def test_a_long_gap_and_the_ends_stay_missing() -> None:
    points = _track(np.nan, 1.0, np.nan, np.nan, 4.0, np.nan)
    filled, is_filled = fill_gaps(points, max_gap=1)
    np.testing.assert_array_equal(filled, points)
    assert not is_filled.any()


def test_trajectories_do_not_mix() -> None:
    points = np.concatenate([_track(0.0, np.nan, 2.0), _track(10.0, 20.0, np.nan)], axis=1)
    filled, is_filled = fill_gaps(points, max_gap=5)
    np.testing.assert_allclose(filled[1, :, 0], [1.0, 20.0])
    assert is_filled.tolist() == [[False, False], [True, False], [False, False]]
