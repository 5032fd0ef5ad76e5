import numpy as np

from assemblyhands_core.data.outcomes import outcome_columns
from assemblyhands_core.geometry.triangulation import Triangulation


def _found() -> Triangulation:
    """Four points in three views: good, good by two, refused with inliers, seen by nobody."""
    nan = np.nan
    return Triangulation(
        points_world_mm=np.array([[1.0, 2, 3], [4, 5, 6], [nan, nan, nan], [nan, nan, nan]]),
        is_inlier=np.array([[True, True, True], [True, False, True], [True, False, False], [False] * 3]),
        reprojection_px=np.array([[1.0, 2, 6], [2.0, 90, 4], [1.0, 70, nan], [nan, nan, nan]]),
        status=np.array(["ok", "ok", "high_reprojection", "too_few_views"]),
    )


def test_columns_have_a_row_for_so_many_points() -> None:
    columns = outcome_columns(_found(), 2)
    assert columns["valid"].tolist() == [[True, True], [False, False]]
    assert columns["reason"].tolist() == [["", ""], ["high_reprojection", "too_few_views"]]
    assert columns["num_views"].tolist() == [[3, 2], [1, 0]]


def test_the_error_is_the_mean_of_inliers_and_missing_with_the_point() -> None:
    error_px = outcome_columns(_found(), 4)["reprojection_px"]
    np.testing.assert_array_equal(error_px, [[3.0, 3.0, np.nan, np.nan]])


def test_no_points_have_no_rows() -> None:
    nobody = Triangulation(np.empty((0, 3)), np.empty((0, 3), bool), np.empty((0, 3)), np.empty(0, str))
    assert {name: values.shape for name, values in outcome_columns(nobody, 21).items()} == {
        "valid": (0, 21),
        "reason": (0, 21),
        "num_views": (0, 21),
        "reprojection_px": (0, 21),
    }
