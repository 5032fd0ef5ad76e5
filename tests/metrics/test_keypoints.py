import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST
from assemblyhands_core.hands.wrist import relative_to_wrist
from assemblyhands_core.metrics.keypoints import (
    Score,
    joint_errors_mm,
    mean_of_joint_means_mm,
    mpjpe_mm,
    pck_auc,
    pck_auc_shares,
    pck_curve,
)

NAN = float("nan")


def _case(*errors: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return prediction, truth and valid of joints that are that far off along x."""
    true = np.random.default_rng(0).normal(0, 100, (*np.shape(errors), 3))
    predicted = true + np.array(errors)[..., None] * [1.0, 0, 0]
    return predicted, true, np.ones(np.shape(errors), bool)


def test_mpjpe_pools_what_was_found_and_says_how_much_that_is() -> None:
    score = mpjpe_mm(*_case([3.0, NAN], [5.0, 10.0]))
    assert score == pytest.approx(6.0) and score.n == 3 and score.coverage == 75.0
    assert str(score) == "6.00 (n = 3, coverage 75.0 %)"
    assert mean_of_joint_means_mm(*_case([3.0, NAN], [5.0, 10.0])) == pytest.approx((4 + 10) / 2)


def test_what_is_not_labelled_does_not_count_wherever_it_is() -> None:
    predicted, true, valid = _case([3.1, 100.0], [4.9, NAN])
    valid[:, 1] = False
    true[0, 1] = NAN
    for score, value in ((mpjpe_mm(predicted, true, valid), 4.0), (pck_auc(predicted, true, valid), 80.0)):
        assert score == pytest.approx(value) and score.n == 2 and score.coverage == 100.0
    assert np.array_equal(np.isnan(joint_errors_mm(predicted, true, valid)), ~valid)


def test_pck_auc_by_hand() -> None:
    """Thresholds 0, 10, 20: a joint 10 mm off is right at 10 and 20, (0/2 + 1 + 1/2) of 2 steps."""
    assert pck_auc(*_case([10.0]), num_thresholds=3) == pytest.approx(75.0)
    assert pck_auc(*_case([10.0, NAN]), num_thresholds=3) == pytest.approx(37.5)
    assert pck_auc(*_case([0.0])) == 100.0 and pck_auc(*_case([20.01])) == 0.0
    assert pck_auc(*_case([20.01]), max_mm=50.0) == pytest.approx(100 * (1 - 20.01 / 50), abs=1)


def test_the_area_is_that_under_the_curve() -> None:
    errors = np.random.default_rng(1).gamma(2, 5, (50, 3))
    errors[::7, 1] = NAN
    valid = np.random.default_rng(2).random((50, 3)) < 0.9
    thresholds = np.linspace(0, 20, 101)
    curve = pck_curve(errors, valid, thresholds)
    assert np.all(np.diff(curve) >= 0) and curve[-1] == pytest.approx(100 * np.mean((errors <= 20)[valid]))
    assert 100 * np.mean(pck_auc_shares(errors)[valid]) == pytest.approx(np.trapezoid(curve, thresholds) / 20, abs=1e-9)


def test_without_labels_there_is_no_figure() -> None:
    predicted, true, _ = _case([1.0, 2.0])
    valid = np.zeros((1, 2), bool)
    for score in (mpjpe_mm(predicted, true, valid), pck_auc(predicted, true, valid)):
        assert np.isnan(score) and np.isnan(score.coverage) and score.n == 0
    assert np.isnan(pck_curve(np.zeros((1, 2)), valid, np.zeros(3))).all()


def test_relative_to_each_hands_own_wrist() -> None:
    points = np.random.default_rng(3).normal(0, 100, (2, 42, 3))
    moved = points.copy()
    moved[:, :NUM_JOINTS] += [1.0, 2, 3]
    moved[:, NUM_JOINTS:] -= [30.0, 0, 9]
    assert np.allclose(relative_to_wrist(moved), relative_to_wrist(points))
    assert np.all(relative_to_wrist(points)[:, [WRIST, NUM_JOINTS + WRIST]] == 0)


def test_a_score_survives_copying() -> None:
    score = copy.copy(Score(1.5, 50.0, 7))
    assert (score, score.coverage, score.n) == (1.5, 50.0, 7)


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> Any:
    with np.load(golden_dir / "metrics.npz") as file:
        return dict(file)


def test_same_figures_as_the_hand_tracking_toolkit(golden: Any) -> None:
    everything = np.ones_like(golden["joint_valid"])
    case = golden["pred"], golden["gt"], everything
    assert np.allclose(joint_errors_mm(*case), golden["errors"], rtol=0, atol=1e-9)
    assert mpjpe_mm(*case) == pytest.approx(float(golden["mpjpe_htt"]), abs=1e-6)
    assert pck_auc(*case, 50.0, 101) == pytest.approx(float(golden["pck_auc_htt_0_50_101"]), abs=1e-4)
    fingertips = (values[:, :5] for values in case)
    assert pck_auc(*fingertips, 50.0, 101) == pytest.approx(float(golden["fingertip_auc_htt"]), abs=1e-4)


def test_same_areas_and_curves_at_every_step(golden: Any) -> None:
    predicted = np.where(golden["pred_missing"][..., None], NAN, golden["pred"])
    valid = golden["joint_valid"]
    for index, name in enumerate(golden["auc_names"]):
        max_mm, steps = float(name.split("-")[1].split("mm")[0]), int(name.split("_")[1].removesuffix("steps"))
        found = [pck_auc(p, golden["gt"], v, max_mm, steps) / 100 for p, v in (
            (golden["pred"], np.ones_like(valid)), (golden["pred"], valid), (predicted, valid))]  # fmt: skip
        wanted = [golden[f"auc_htt_{kind}"][index] for kind in ("all", "valid", "valid_missing_as_inf")]
        assert np.allclose(found, wanted, rtol=0, atol=1e-9), name
        curve = pck_curve(golden["errors"], valid, np.linspace(0, max_mm, steps))
        reference = golden[f"pck_curve_valid_0_{max_mm:.0f}_{steps}"]
        assert np.allclose(curve, reference * (100 if reference.max() <= 1 else 1), rtol=0, atol=1e-9)
    no_step = golden["auc_exact_limit_20_50_valid"][0]
    assert pck_auc(golden["pred"], golden["gt"], valid) == pytest.approx(100 * no_step, abs=0.1)


def test_same_wrist_relative_figure_as_the_assemblyhands_toolkit(golden: Any) -> None:
    """The toolkit's network gives 64³ bins of a 256 px crop and a depth of ±200 mm around the true wrist's."""
    bins = golden["B_pred_heatmap_xyz"]
    depth = (bins[..., 2] / 64 * 2 - 1) * 200 + np.repeat(golden["B_abs_depth_right_left"], NUM_JOINTS, axis=1)
    pixels = bins[..., :2] * 256 / 64
    rays = (pixels - golden["B_princpt"][:, None]) / golden["B_focal"][:, None]
    predicted = np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)
    case = relative_to_wrist(predicted), relative_to_wrist(golden["B_gt_cam"]), golden["B_joint_valid"] > 0
    error = joint_errors_mm(*case)
    by_joint = [np.mean(joint[np.isfinite(joint)]) for joint in error.T]
    assert np.allclose(by_joint, golden["B_per_joint_mpjpe"], rtol=0, atol=1e-9)
    assert mean_of_joint_means_mm(*case) == pytest.approx(float(golden["B_mpjpe"]), abs=1e-9)
