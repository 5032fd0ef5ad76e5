import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry.smoothing import SmoothingRule, smooth

RULE = SmoothingRule(max_gap_frames=5, cutoff_period_frames=7.0, max_deviation_sd=8.0)
NUM_FRAMES = 300
FRAME = np.arange(NUM_FRAMES)


def _reach() -> np.ndarray:
    """Return a joint's course (F, 1, 3) over ten seconds: 200 mm to and fro in 2 s, up to 21 mm a frame."""
    swing = 2 * np.pi * FRAME[:, None] / 60
    return np.concatenate([200 * np.sin(swing), 60 * np.sin(2 * swing), 900 + 30 * np.cos(swing)], axis=1)[:, None]


def _noise(sd_mm: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=sd_mm, size=(NUM_FRAMES, 1, 3))


def _errors(points: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(points - true, axis=-1))


@pytest.mark.parametrize("sd_mm", [1.0, 3.0, 6.0])
def test_noise_on_a_moving_hand_falls_by_a_third_or_more_and_by_no_miracle(sd_mm: float) -> None:
    smoothed, _ = smooth(_reach() + _noise(sd_mm), FRAME, RULE)
    ratio = _errors(smoothed, _reach()).mean() / _errors(_noise(sd_mm), np.zeros(3)).mean()
    assert 0.4 < ratio < 0.67


@given(
    st.lists(st.floats(-1000, 1000), min_size=3, max_size=3),
    st.lists(st.floats(-60, 60), min_size=3, max_size=3),
    st.lists(st.floats(-2, 2), min_size=3, max_size=3),
)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_steady_and_evenly_accelerated_motion_stay_as_they_are(
    start_mm: list[float], speed_mm: list[float], half_mm: list[float]
) -> None:
    t = np.arange(40.0)[:, None]
    course = (np.array(start_mm) + t * np.array(speed_mm) + t**2 * np.array(half_mm))[:, None]
    smoothed, _ = smooth(course, np.arange(40), RULE)
    np.testing.assert_allclose(smoothed, course, atol=1e-6)


def test_steady_motion_is_found_behind_strays_and_gaps() -> None:
    true = np.array([5.0, -300.0, 900.0]) + FRAME[:, None, None] * np.array([20.0, -7.0, 3.0])
    points = true.copy()
    points[[40, 90, 91, 160]] += np.array([60.0, -100.0, 400.0])
    points[88:90] = points[161:166] = np.nan
    smoothed, is_filled = smooth(points, FRAME, RULE)
    np.testing.assert_allclose(smoothed, true, atol=0.01)
    assert np.flatnonzero(is_filled).tolist() == [88, 89, *range(161, 166)]


@pytest.mark.parametrize("size_mm", [40.0, 150.0, 1000.0])
def test_a_stray_comes_back_and_leaves_its_neighbours_where_they_were(size_mm: float) -> None:
    points = _reach() + _noise(2.0)
    strayed = points.copy()
    strayed[30::50] += size_mm / np.sqrt(3)
    pull = _errors(smooth(strayed, FRAME, RULE)[0], smooth(points, FRAME, RULE)[0]).ravel()
    is_stray = np.isin(FRAME, np.arange(30, NUM_FRAMES, 50))
    assert pull[~is_stray].max() < 2.0
    assert 0 < pull[is_stray].max() < 6.0
    loose = SmoothingRule(5, 7.0, 1e9)
    assert _errors(smooth(strayed, FRAME, loose)[0], _reach()).max() > size_mm / 8  # it is the rule that does it


def test_quick_movements_are_not_taken_for_strays() -> None:
    jerky = np.repeat([[[0.0, 0.0, 900.0]]], NUM_FRAMES, axis=0)
    jerky[150:, 0, 0] = 250.0
    jerky[145:150, 0, 0] = 250 * np.array([0.04, 0.25, 0.5, 0.75, 0.96])  # 1.9 m/s out of rest, and to rest again
    error = _errors(smooth(jerky + _noise(1.0), FRAME, RULE)[0], jerky)
    assert 0.5 < error.max() < 25.0 and np.delete(error, np.s_[138:157]).max() < 4.0


def test_gaps_are_filled_up_to_the_limit_along_the_course_and_nothing_crosses_longer_ones() -> None:
    points = _reach()
    points[100:105] = points[200:206] = points[:2] = points[-1:] = np.nan
    smoothed, is_filled = smooth(points, FRAME, RULE)
    assert np.flatnonzero(is_filled).tolist() == list(range(100, 105))
    assert np.flatnonzero(np.isnan(smoothed).any(axis=(1, 2))).tolist() == [0, 1, *range(200, 206), 299]
    assert _errors(smoothed, _reach())[100:105].max() < 2.0  # a straight line would be off by 9 mm
    moved = points.copy()
    moved[206:] += 500.0
    np.testing.assert_allclose(smooth(moved, FRAME, RULE)[0][:200], smoothed[:200], atol=0.05)
    np.testing.assert_allclose(smooth(moved, FRAME, RULE)[0][206:-1], smoothed[206:-1] + 500.0, atol=0.05)


def test_a_stray_does_not_spoil_the_gap_beside_it() -> None:
    points = _reach() + _noise(1.0)
    points[100:104] = np.nan
    strayed = points.copy()
    strayed[104] += 150.0
    filled, is_filled = smooth(strayed, FRAME, RULE)
    assert is_filled.sum() == 4 and _errors(filled, _reach())[100:105].max() < 10.0


def test_frames_that_have_no_row_are_gaps() -> None:
    true = np.repeat(FRAME[:, None, None] * np.array([[[20.0, 1.0, 0.0]]]), 2, axis=1)
    shown = np.delete(FRAME, np.s_[50:54])
    points = true[shown]
    points[50, 0] = np.nan  # frame 54: with the four before it a gap of five
    smoothed, is_filled = smooth(points, shown, RULE)
    assert is_filled[:, 0].nonzero()[0].tolist() == [50] and not is_filled[:, 1].any()
    np.testing.assert_allclose(smoothed, true[shown], atol=1e-6)
    points[51, 0] = np.nan  # a gap of six
    assert not smooth(points, shown, RULE)[1].any()
    far = np.array([0, 1, 10**12, 10**12 + 1])
    np.testing.assert_allclose(smooth(points[:4], far, RULE)[0], points[:4], atol=1e-6)


@pytest.mark.parametrize("count", range(4))
def test_a_few_frames_stay_as_they_are_and_nothing_stays_nothing(count: int) -> None:
    points = np.random.default_rng(1).normal(scale=100.0, size=(count, 2, 3))
    points[:, 1] = np.nan
    smoothed, is_filled = smooth(points, np.arange(count) + 7, RULE)
    np.testing.assert_allclose(smoothed, points, atol=1e-9)
    assert smoothed.shape == (count, 2, 3) and not is_filled.any()


def test_two_known_ends_of_a_gap_are_joined_by_a_line() -> None:
    points = np.full((4, 1, 3), np.nan)
    points[0], points[3] = 0.0, 3.0
    np.testing.assert_allclose(smooth(points, np.arange(4), RULE)[0][:, 0, 0], [0.0, 1.0, 2.0, 3.0], atol=1e-6)


@pytest.mark.parametrize("frame", [[0, 0, 1], [0, 2, 1]])
def test_frames_out_of_order_are_refused(frame: list[int]) -> None:
    with pytest.raises(ValueError, match="do not ascend"):
        smooth(np.zeros((3, 1, 3)), np.array(frame), RULE)
