"""How far joints are from the truth, in the paper's figures: MPJPE in mm and PCK-AUC over 0-20 mm in percent.

Arrays are (row, joint): a row is a hand, or both hands, at one instant. A joint is *labelled* where the truth is known
(``valid``) and *found* where moreover the prediction is finite. Positions count over the found joints, so that MPJPE
says nothing without coverage; PCK counts over the labelled ones, a missing joint being wrong at every threshold.

Where papers and toolkits differ: PCK takes errors equal to the threshold as correct, pools all joints and integrates
by trapezoids over ``num_thresholds`` equal steps from 0, divided by the range (formats 4.4; hand_tracking_toolkit). The
paper states 0-20 mm but no step; ours is 0.2 mm, and the limit of no step differs by less than 0.1 points.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

MAX_MM: Final = 20.0
NUM_THRESHOLDS: Final = 101


class Score(float):
    """A figure that knows what it is of, and says so when it is printed.

    Attributes:
        coverage: Percentage of the labelled joints that were found.
        n: The number of joints that the figure is of.
    """

    coverage: float
    n: int

    def __new__(cls, value: float, coverage: float, n: int) -> "Score":
        """Return the figure."""
        score = super().__new__(cls, value)
        score.coverage, score.n = coverage, n
        return score

    def __getnewargs__(self) -> tuple[float, float, int]:  # type: ignore[override]
        """Return what copies and pickles are made of."""
        return float(self), self.coverage, self.n

    def __str__(self) -> str:
        """Return value, n and coverage."""
        return f"{float(self):.2f} (n = {self.n}, coverage {self.coverage:.1f} %)"


def joint_errors_mm(
    predicted: Float[np.ndarray, "row joint 3"],
    true: Float[np.ndarray, "row joint 3"],
    valid: Bool[np.ndarray, "row joint"],
) -> Float[np.ndarray, "row joint"]:
    """Return the distance of every joint to the truth; NaN where it is not labelled or was not found."""
    distance_mm = np.linalg.norm(predicted - np.where(valid[..., None], true, np.nan), axis=-1)
    return np.where(np.isfinite(distance_mm), distance_mm, np.nan)


def mpjpe_mm(
    predicted: Float[np.ndarray, "row joint 3"],
    true: Float[np.ndarray, "row joint 3"],
    valid: Bool[np.ndarray, "row joint"],
) -> Score:
    """Return the mean error in mm over all joints that were found, pooled; NaN if none was."""
    error_mm = joint_errors_mm(predicted, true, valid)
    found = error_mm[np.isfinite(error_mm)]
    return Score(_mean(found), coverage_percent(error_mm, valid), found.size)


def mean_of_joint_means_mm(
    predicted: Float[np.ndarray, "row joint 3"],
    true: Float[np.ndarray, "row joint 3"],
    valid: Bool[np.ndarray, "row joint"],
) -> Score:
    """Return the mean over joints of each joint's mean error in mm: the AssemblyHands toolkit's form (formats 2.8).

    It differs from the pooled `mpjpe_mm` where joints are found unequally often. Joints never found do not enter.
    """
    error_mm = joint_errors_mm(predicted, true, valid)
    mean_mm = mean_of_joint_means(error_mm)
    return Score(mean_mm, coverage_percent(error_mm, valid), int(np.isfinite(error_mm).sum()))


def mean_of_joint_means(error_mm: Float[np.ndarray, "row joint"]) -> float:
    """Return the mean over joints of the mean of each one's finite errors; NaN if there are none."""
    means = [_mean(joint[np.isfinite(joint)]) for joint in error_mm.T if np.isfinite(joint).any()]
    return _mean(np.array(means))


def pck_auc(
    predicted: Float[np.ndarray, "row joint 3"],
    true: Float[np.ndarray, "row joint 3"],
    valid: Bool[np.ndarray, "row joint"],
    max_mm: float = MAX_MM,
    num_thresholds: int = NUM_THRESHOLDS,
) -> Score:
    """Return the area under the PCK curve from 0 to `max_mm` in percent; missing joints are wrong."""
    error_mm = joint_errors_mm(predicted, true, valid)
    share = pck_auc_shares(error_mm, max_mm, num_thresholds)[valid]
    return Score(100 * _mean(share), coverage_percent(error_mm, valid), share.size)


def pck_curve(
    error_mm: Float[np.ndarray, "row joint"],
    valid: Bool[np.ndarray, "row joint"],
    thresholds_mm: Float[np.ndarray, " threshold"],
) -> Float[np.ndarray, " threshold"]:
    """Return the percentage of the labelled joints that are at most each threshold off; NaN (missing) never is."""
    errors = np.sort(error_mm[valid])
    if not errors.size:
        return np.full(len(thresholds_mm), np.nan)
    return 100.0 * np.searchsorted(errors[np.isfinite(errors)], thresholds_mm, side="right") / errors.size


def pck_auc_shares(
    error_mm: Float[np.ndarray, "..."], max_mm: float = MAX_MM, num_thresholds: int = NUM_THRESHOLDS
) -> Float[np.ndarray, "..."]:
    """Return each joint's share in [0, 1] of the area under the PCK curve; the area is their mean.

    A joint with error e adds the trapezoids of a step from 0 to 1 at the first threshold ≥ e; 0 if it is missing.
    """
    thresholds_mm = np.linspace(0, max_mm, num_thresholds)
    weights = np.full(num_thresholds, 1.0)
    weights[[0, -1]] = 0.5
    areas = np.append(np.cumsum(weights[::-1])[::-1] / (num_thresholds - 1), 0.0)
    return np.asarray(areas[np.searchsorted(thresholds_mm, error_mm)])  # NaN sorts past the last threshold


def coverage_percent(error_mm: Float[np.ndarray, "row joint"], valid: Bool[np.ndarray, "row joint"]) -> float:
    """Return the percentage of the labelled joints that were found; NaN without labels."""
    return 100 * _mean(np.isfinite(error_mm[valid]))


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if values.size else float("nan")
