"""Lens models: closed-form numbers, exact inverses, honest ends of the field."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.geometry.distortion import (
    COEFFICIENT_NAMES,
    Lens,
    OpenCVLens,
    OVFishEye62,
    Pinhole,
    lens_from_coefficients,
)

LENSES: list[Lens] = [
    Pinhole(),
    OpenCVLens(k1=-0.13, k2=0.12, k3=-0.02, p1=-6e-4, p2=7e-4),
    OpenCVLens(k1=0.4, k2=0.05, p1=1e-3, p2=-2e-3, k4=0.5, k5=0.02, k6=0.001),
    OVFishEye62(k1=0.27, k2=0.1, k3=-0.33, k4=0.26, k5=-0.1, k6=0.015, p1=1.1e-3, p2=-7e-4),
]
HALF_FIELD_RAD = {"Pinhole": 1.4, "OpenCV": 0.9, "OVFishEye62": 2.1}


def _ray(angle: float, azimuth: float) -> np.ndarray:
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def test_pinhole_divides_by_depth() -> None:
    np.testing.assert_array_equal(Pinhole().distort(np.array([2.0, -3.0, 4.0])), [0.5, -0.75])
    np.testing.assert_allclose(Pinhole().undistort(np.array([0.75, 0.0])), [0.6, 0.0, 0.8], rtol=0, atol=1e-15)


def test_opencv_by_hand() -> None:
    # a = 1/2, b = 0, r² = 1/4: radial 1 + 0.4/4 = 1.1; u = 0.55 + p2 (1/4 + 1/2), v = p1/4
    distorted = OpenCVLens(k1=0.4, p1=0.01, p2=0.02).distort(np.array([1.0, 0.0, 2.0]))
    np.testing.assert_allclose(distorted, [0.565, 0.0025], rtol=0, atol=1e-15)


def test_tangential_terms_by_hand_off_the_axes() -> None:
    # OpenCV, (a, b) = (1, 2), r² = 5: u = 1 + 4 p1 + p2 (5 + 2), v = 2 + p1 (5 + 8) + 4 p2
    distorted = OpenCVLens(p1=0.01, p2=0.002).distort(np.array([1.0, 2.0, 1.0]))
    np.testing.assert_allclose(distorted, [1 + 0.04 + 0.014, 2 + 0.13 + 0.008], rtol=0, atol=1e-15)
    # fisheye, θ = 1 at (0.6, 0.8), R² = 1: u = 0.6 + 1.72 p1 + 0.96 p2, v = 0.8 + 2.28 p2 + 0.96 p1
    ray = np.array([0.6 * np.sin(1), 0.8 * np.sin(1), np.cos(1)])
    distorted = OVFishEye62(p1=0.01, p2=0.002).distort(ray)
    expected = [0.6 + 0.0172 + 0.00192, 0.8 + 0.00456 + 0.0096]
    np.testing.assert_allclose(distorted, expected, rtol=0, atol=1e-15)


def test_opencv_rational_by_hand() -> None:
    # r² = 1: radial (1 + 1) / (1 + 3)
    distorted = OpenCVLens(k1=1.0, k4=3.0).distort(np.array([0.0, 1.0, 1.0]))
    np.testing.assert_allclose(distorted, [0.0, 0.5], rtol=0, atol=1e-15)


def test_fisheye_by_hand() -> None:
    # θ = π/2 along y; without distortion (0, π/2); tangential: R² = π²/4, u = p1 R², v = π/2 + 3 p2 R²
    distorted = OVFishEye62(p1=0.01, p2=0.02).distort(np.array([0.0, 5.0, 0.0]))
    squared = np.pi**2 / 4
    np.testing.assert_allclose(distorted, [0.01 * squared, np.pi / 2 + 0.06 * squared], rtol=0, atol=1e-15)
    # θ = π/4 along x: radial 1 + k1 θ²
    distorted = OVFishEye62(k1=0.5).distort(np.array([1.0, 0.0, 1.0]))
    np.testing.assert_allclose(distorted, [np.pi / 4 * (1 + np.pi**2 / 32), 0.0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(share=st.floats(0.0, 1.0), azimuth=st.floats(-np.pi, np.pi))
def test_undistort_inverts_distort(lens: Lens, share: float, azimuth: float) -> None:
    ray = _ray(share * HALF_FIELD_RAD[lens.model], azimuth)
    np.testing.assert_allclose(lens.undistort(lens.distort(ray)), ray, rtol=0, atol=2e-12)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_distort_inverts_undistort_to_the_last_digits(lens: Lens) -> None:
    plane = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 41), np.linspace(-0.6, 0.6, 31)), axis=-1)
    rays = lens.undistort(plane)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(lens.distort(rays), plane, rtol=0, atol=4e-12)


def test_the_field_of_a_barrel_lens_ends_at_the_turning_point() -> None:
    # r (1 + k1 r²) turns at r = 1/sqrt(-3 k1) = 1 with the value 2/3
    lens = OpenCVLens(k1=-1 / 3)
    radii = np.array([0.999, 1.001])
    rays = np.stack((radii, np.zeros(2), np.ones(2)), axis=-1)
    distorted = lens.distort(rays)
    np.testing.assert_allclose(distorted[0, 0], 0.999 - 0.999**3 / 3, rtol=0, atol=1e-15)
    assert np.isnan(distorted[1]).all()
    back = lens.undistort(np.array([[0.666, 0.0], [0.667, 0.0], [5.0, 5.0]]))
    assert np.isfinite(back[0]).all() and np.isnan(back[1:]).all()
    np.testing.assert_allclose(lens.distort(back[0]), [0.666, 0.0], rtol=0, atol=1e-12)


def test_a_fisheye_sees_behind_itself_up_to_its_turning_point_or_pi() -> None:
    equidistant = OVFishEye62()
    np.testing.assert_allclose(equidistant.undistort(np.array([3.1, 0.0])), _ray(3.1, 0.0), rtol=0, atol=1e-14)
    assert np.isnan(equidistant.undistort(np.array([[3.2, 0.0], [-3.0, 3.0]]))).all()
    # θ (1 + k1 θ²) turns at θ = 1/sqrt(-3 k1) = 2
    folding = OVFishEye62(k1=-1 / 12)
    distorted = folding.distort(np.stack((_ray(1.99, 0.5), _ray(2.01, 0.5))))
    assert np.isfinite(distorted[0]).all() and np.isnan(distorted[1]).all()
    assert np.isnan(folding.undistort(np.array([1.34, 0.0]))).all()  # the image ends at 4/3


def test_tangential_terms_end_the_field_before_they_fold_it() -> None:
    # along the axis u = a + 3 p1 a² turns at a = -1/(6 p1) = -2
    for lens, ray in (
        (OVFishEye62(p1=1 / 12), np.stack((_ray(1.99, np.pi), _ray(2.01, np.pi)))),
        (OpenCVLens(p2=1 / 12), np.array([[-1.99, 0.0, 1.0], [-2.01, 0.0, 1.0]])),
    ):
        distorted = lens.distort(ray)
        np.testing.assert_allclose(distorted[0], [-1.99 + 1.99**2 / 4, 0.0], rtol=0, atol=1e-12)
        assert np.isnan(distorted[1]).all()
        assert np.isnan(lens.undistort(np.array([-1.001, 0.0]))).all()


def test_nothing_is_seen_behind_a_perspective_lens() -> None:
    behind = np.array([[1.0, 1.0, -1.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0], [np.nan, 1.0, 1.0]])
    for lens in LENSES[:3]:
        assert np.isnan(lens.distort(behind)).any(axis=-1).all()
    assert np.isnan(LENSES[3].distort(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]))).all()


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_one_bad_pixel_does_not_disturb_the_others(lens: Lens) -> None:
    plane = np.array([[0.1, 0.2], [np.nan, 0.1], [-0.3, 0.05]])
    rays = lens.undistort(plane)
    assert np.isnan(rays[1]).any()
    np.testing.assert_allclose(lens.distort(rays[[0, 2]]), plane[[0, 2]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_shapes_and_types_are_kept(lens: Lens) -> None:
    for dtype in (np.float32, np.float64):
        rays = lens.undistort(np.zeros((2, 0, 2), dtype))
        assert rays.shape == (2, 0, 3) and rays.dtype == dtype
        plane = lens.distort(np.array([0.1, 0.2, 1.0], dtype))
        assert plane.shape == (2,) and plane.dtype == dtype


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_coefficients_are_stored_and_restored(lens: Lens) -> None:
    assert lens.coefficients().shape == (10,)
    assert lens_from_coefficients(lens.model, lens.coefficients()) == lens
    named = dict(zip(COEFFICIENT_NAMES, lens.coefficients().tolist(), strict=True))
    assert lens_from_coefficients(lens.model, named) == lens


def test_wrong_lenses_are_refused() -> None:
    with pytest.raises(ValueError, match="'Brown' is not supported: use one of Pinhole, OpenCV, OVFishEye62"):
        lens_from_coefficients("Brown", {})
    with pytest.raises(ValueError, match=r"Pinhole has no k1=0\.1"):
        lens_from_coefficients("Pinhole", {"k1": 0.1})
    with pytest.raises(ValueError, match="finite"):
        lens_from_coefficients("OpenCV", {"k1": float("nan")})
    with pytest.raises(ValueError, match="finite"):
        lens_from_coefficients("OpenCV", {"k9": 1.0})
