"""Parity of triangulation with reference programs, and its accuracy against the truth."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.geometry.triangulation import Triangulation, triangulate

MAX_DISTANCE_MM = 1e-6


@pytest.fixture(scope="module")
def golden(golden_dir: Path) -> dict[str, np.ndarray]:
    return dict(np.load(golden_dir / "triangulate_dlt.npz"))


@pytest.fixture(scope="module")
def rigs(golden: dict[str, np.ndarray], calibration_dir: Path) -> list[list[Camera]]:
    rigs = []
    for name, serials in zip(golden["seq"], golden["serial"], strict=True):
        cameras = load_assembly101_calibration(calibration_dir / f"{name}.json")
        rigs.append([cameras[str(serial)] for serial in serials])
    return rigs


def _cases(golden: dict[str, np.ndarray], rigs: list[list[Camera]]) -> Iterator[tuple[tuple[int, int], list[Camera]]]:
    for recording, cameras in enumerate(rigs):
        for group in range(len(golden["groups"])):
            yield (recording, group), cameras


def _robust(golden: dict[str, np.ndarray], rigs: list[list[Camera]], group: str) -> list[Triangulation]:
    index = golden["groups"].tolist().index(group)
    pixels = golden["obs_distorted"][:, index].swapaxes(1, 2)
    return [triangulate(observed, cameras) for observed, cameras in zip(pixels, rigs, strict=True)]


def _errors_mm(golden: dict[str, np.ndarray], group: str, found: list[Triangulation]) -> np.ndarray:
    truth = golden["gt_points"][:, golden["groups"].tolist().index(group)]
    return np.linalg.norm(np.stack([points.points_world_mm for points in found]) - truth, axis=-1)


def test_linear_equals_anipose_from_raw_pixels(golden: dict[str, np.ndarray], rigs: list[list[Camera]]) -> None:
    for at, cameras in _cases(golden, rigs):
        found = triangulate(golden["obs_distorted"][at].swapaxes(0, 1), cameras, robust=False)
        for reference in ("anipose_dlt", "anipose_dlt_normalized"):
            np.testing.assert_allclose(found.points_world_mm, golden[reference][at], rtol=0, atol=MAX_DISTANCE_MM)


def test_linear_in_pixel_units_equals_learnable_triangulation(
    golden: dict[str, np.ndarray], rigs: list[list[Camera]]
) -> None:
    for at, cameras in _cases(golden, rigs):
        pixels = golden["obs_pinhole"][at].swapaxes(0, 1)
        even = np.ones(pixels.shape[:2])
        found = triangulate(pixels, [rectified(camera) for camera in cameras], even, robust=False)
        for reference in ("lt_linear", "lt_linear_torch"):
            np.testing.assert_allclose(found.points_world_mm, golden[reference][at], rtol=0, atol=MAX_DISTANCE_MM)


def test_confidence_weighted_linear_equals_learnable_triangulation(
    golden: dict[str, np.ndarray], rigs: list[list[Camera]]
) -> None:
    for at, cameras in _cases(golden, rigs):
        confidence = golden["confidences"][at].swapaxes(0, 1)
        found = triangulate(golden["obs_distorted"][at].swapaxes(0, 1), cameras, confidence, robust=False)
        reference = golden["lt_linear_torch_conf"][at]
        np.testing.assert_allclose(found.points_world_mm, reference, rtol=0, atol=MAX_DISTANCE_MM)


@pytest.mark.parametrize("group", ["sigma1", "outlier1"])
def test_inliers_are_those_that_were_injected(
    golden: dict[str, np.ndarray], rigs: list[list[Camera]], group: str
) -> None:
    index = golden["groups"].tolist().index(group)
    for recording, found in enumerate(_robust(golden, rigs, group)):
        np.testing.assert_array_equal(found.is_inlier.T, golden["lt_ransac_inliers"][recording, index])
        assert (found.status == "ok").all()


@pytest.mark.parametrize("group", ["sigma1", "outlier1"])
def test_robust_points_are_near_the_linear_ones_of_their_inliers(
    golden: dict[str, np.ndarray], rigs: list[list[Camera]], group: str
) -> None:
    for at, cameras in _cases(golden, rigs):
        if golden["groups"][at[1]] != group:
            continue
        pixels = golden["obs_distorted"][at].swapaxes(0, 1).copy()
        found = triangulate(pixels, cameras)
        pixels[~found.is_inlier] = np.nan
        linear = triangulate(pixels, cameras, robust=False)
        # the linear system minimises another error: at 1 px noise the two differ by less than the noise moves either
        assert np.abs(found.points_world_mm - linear.points_world_mm).max() < 0.8


@pytest.mark.parametrize(
    ("group", "low_mm", "high_mm"),
    [("sigma0", 0.0, 1e-6), ("sigma1", 0.38, 0.51), ("sigma5", 2.3, 3.0), ("outlier1", 0.44, 0.525)],
)
def test_robust_accuracy(
    golden: dict[str, np.ndarray], rigs: list[list[Camera]], group: str, low_mm: float, high_mm: float
) -> None:
    errors = _errors_mm(golden, group, _robust(golden, rigs, group))
    for recording in range(len(errors)):
        assert low_mm <= np.median(errors[recording]) <= high_mm
    assert errors.max() < 8 * max(high_mm, 1e-6)


def test_points_with_missing_views(golden: dict[str, np.ndarray], rigs: list[list[Camera]]) -> None:
    found = _robust(golden, rigs, "missing1")
    for points in found:
        assert points.status[:2].tolist() == ["too_few_views", "too_few_views"]
        assert (points.status[2:] == "ok").all() and points.num_views[2] == 2
    errors = _errors_mm(golden, "missing1", found)
    assert np.isnan(errors[:, :2]).all() and 0.5 < np.median(errors[:, 2:]) < 0.8
