import numpy as np

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.geometry.synchronisation import estimate_synchronisation

NUM_FRAMES = 40


def _rig() -> list[Camera]:
    cameras = []
    for angle in (0.0, 0.9, 1.8, 2.7):
        rotation = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        pose = np.eye(4)
        pose[:3, :3], pose[2, 3] = rotation, 2000.0
        cameras.append(Camera(f"c{angle}", 1000, 1000, 1000.0, 1000.0, 499.5, 499.5, Pinhole(), pose))
    return cameras


def _walk(speed_mm: float) -> np.ndarray:
    """Return (F, K, 3) points on a curve, so that every moment looks different."""
    t = np.arange(NUM_FRAMES)[:, None]
    offset = np.arange(5)[None, :] * 40.0
    return np.stack([speed_mm * t + offset, 50 * np.sin(t / 4) + offset * 0.5, 30 * np.cos(t / 3) - offset], axis=-1)


def _seen(cameras: list[Camera], points: np.ndarray, late_view: int, by: int) -> np.ndarray:
    seen = np.stack([camera.project(points) for camera in cameras], axis=1)
    if by:
        seen[by:, late_view] = seen[: NUM_FRAMES - by, late_view].copy()
        seen[:by, late_view] = np.nan
    return seen


def test_a_late_view_is_found_and_the_others_are_not_blamed() -> None:
    cameras = _rig()
    keypoints = _seen(cameras, _walk(6.0), late_view=2, by=3)
    confidence = np.isfinite(keypoints[..., 0]).astype(float)
    found = estimate_synchronisation(keypoints, confidence, cameras, max_shift=5, max_reprojection_px=2.0)
    assert found.best_shift.tolist() == [0, 0, 3, 0]
    assert found.error_best_px[2] < 1e-3 < 3.0 < found.error_now_px[2]


def test_a_view_that_looks_elsewhere_is_not_taken_for_a_late_one() -> None:
    cameras = _rig()
    keypoints = _seen(cameras, _walk(6.0), late_view=0, by=0)
    keypoints[:, 1] += [12.0, -5.0]
    confidence = np.ones(keypoints.shape[:-1])
    found = estimate_synchronisation(keypoints, confidence, cameras, max_shift=5, max_reprojection_px=2.0)
    assert found.best_shift.tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(found.offset_px, [[0, 0], [12, -5], [0, 0], [0, 0]], atol=1e-6)


def test_too_little_to_see_says_nothing() -> None:
    cameras = _rig()
    keypoints = np.full((NUM_FRAMES, 4, 5, 2), np.nan)
    found = estimate_synchronisation(
        keypoints, np.zeros((NUM_FRAMES, 4, 5)), cameras, max_shift=2, max_reprojection_px=2.0
    )
    assert found.best_shift.tolist() == [0, 0, 0, 0]
    assert np.isnan(found.error_px).all()


def test_a_late_view_does_not_make_others_look_late_where_outliers_are_let_in() -> None:
    cameras = _rig()
    noise = 2.0 * np.random.default_rng(0).standard_normal((NUM_FRAMES, 4, 5, 2))
    keypoints = _seen(cameras, _walk(6.0), late_view=2, by=3) + noise
    confidence = np.isfinite(keypoints[..., 0]).astype(float)
    found = estimate_synchronisation(keypoints, confidence, cameras, max_shift=5, max_reprojection_px=40.0)
    assert found.best_shift.tolist() == [0, 0, 3, 0]
    assert found.error_now_px[2] > 2 * found.error_best_px[2]
    np.testing.assert_allclose(np.delete(found.error_now_px, 2), 2.9, atol=0.5)  # the noise: others' delay is taken out


def test_two_views_say_nothing() -> None:
    cameras = _rig()[:2]
    keypoints = _seen(cameras, _walk(6.0), late_view=1, by=3)
    found = estimate_synchronisation(
        keypoints, np.ones(keypoints.shape[:-1]), cameras, max_shift=5, max_reprojection_px=2.0
    )
    assert found.best_shift.tolist() == [0, 0] and np.isnan(found.error_now_px).all()


def test_shifts_beyond_a_short_recording_say_nothing() -> None:
    cameras = _rig()
    keypoints = _seen(cameras, _walk(6.0), late_view=0, by=0)[:7]
    found = estimate_synchronisation(
        keypoints, np.ones(keypoints.shape[:-1]), cameras, max_shift=9, max_reprojection_px=2.0
    )
    assert found.best_shift.tolist() == [0, 0, 0, 0]
    assert np.isnan(found.error_px[:, np.abs(found.shift) > 1]).all()  # fewer than 30 points are left to compare
    assert np.isfinite(found.error_now_px).all()
