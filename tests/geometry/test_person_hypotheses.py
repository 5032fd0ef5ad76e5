import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry.person_hypotheses import midpoints


def unit(*vector: float) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def test_the_midpoint_of_two_skew_rays_lies_halfway_between_them() -> None:
    # Along x at height 0 and along y at height 10 through x = 30: they come closest at (30, 0, 0) and (30, 0, 10).
    point = midpoints(np.zeros(3), unit(1, 0, 0), np.array([30.0, -20.0, 10.0]), unit(0, 1, 0))
    np.testing.assert_allclose(point, [30.0, 0.0, 5.0], atol=1e-12)


def test_parallel_rays_rays_that_meet_behind_and_missing_rays_have_no_midpoint() -> None:
    origin, right = np.zeros(3), np.array([100.0, 0.0, 0.0])
    ahead, inward, outward = unit(0, 0, 1), unit(-1, 0, 1), unit(1, 0, 1)
    np.testing.assert_allclose(midpoints(origin, ahead, right, inward), [0.0, 0.0, 100.0], atol=1e-9)
    assert np.isnan(midpoints(origin, ahead, right, ahead)).all()
    assert np.isnan(midpoints(origin, ahead, right, outward)).all()
    assert np.isnan(midpoints(origin, np.full(3, np.nan), right, inward)).all()


COORDINATE = st.floats(-500.0, 500.0)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.tuples(COORDINATE, COORDINATE, st.floats(1500.0, 4000.0)))
def test_rays_through_a_point_meet_in_it(point: tuple[float, float, float]) -> None:
    target, first, second = np.array(point), np.array([-1000.0, 0.0, 0.0]), np.array([1000.0, 300.0, 0.0])
    found = midpoints(first, unit(*(target - first)), second, unit(*(target - second)))
    np.testing.assert_allclose(found, target, atol=1e-6)
