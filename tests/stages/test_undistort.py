"""Rectification, checked against lenses whose rectified image is known without it."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row, valid_cameras
from assemblyhands_core.data.catalog import VIEWS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.video import VideoReader, VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Lens, OpenCVLens, OVFishEye62, Pinhole
from assemblyhands_core.geometry.regions import RemapGrid
from stages._contract import Context
from stages.undistort import STAGE, UndistortConfig, round_trip_residual_px

WIDTH_PX, HEIGHT_PX = 64, 48
BARREL = OpenCVLens(k1=-0.2, k2=0.03, p1=1e-3, p2=-5e-4)
FISHEYE = OVFishEye62(k1=0.2, k2=-0.1)
CONFIG = UndistortConfig(
    focal_scale_perspective=1.0,
    focal_scale_fisheye=0.7,
    grid_step_px=8,
    lattice_step_px=4,
    max_residual_px=0.02,
    materialize=False,
    video_crf=0,
)


def _camera(name: str, lens: Lens) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = (10.0, -20.0, 500.0)
    return Camera(name, WIDTH_PX, HEIGHT_PX, 50.0, 52.0, 31.0, 24.5, lens, pose)


def _view(camera: Camera | None, name: str = "gone", video: Path | str = "", num_frames: int = 0) -> dict[str, object]:
    row = {"sequence_id": "s", "camera_id": camera.camera_id if camera else name, "video_file": str(video)}
    row |= {"video_sha256": "", "num_frames": num_frames, "rate_hz": 30.0, "image_fit": "same", "note": ""}
    row |= camera_to_row(camera) if camera else missing_camera_row()
    return row | {"valid": camera is not None, "reason": "" if camera else "missing_video"}


def _run(*views: dict[str, object], config: UndistortConfig = CONFIG, folder: Path = Path()) -> pa.Table:
    inputs = {"views": VIEWS.from_rows(views)}
    return STAGE.run(config, inputs, Context(folder, "s"))["rectified_views"]


def test_every_view_has_a_row_and_bad_ones_keep_their_reason() -> None:
    table = _run(_view(_camera("a", BARREL)), _view(None, "b"), _view(_camera("c", FISHEYE)))
    assert table.column("camera_id").to_pylist() == ["a", "b", "c"]
    assert table.column("valid").to_pylist() == [True, False, True]
    assert table.column("reason").to_pylist() == ["", "missing_video", ""]
    hole = table.to_pylist()[1]
    assert hole["grid"] == b"" and np.isnan(hole["kept_fraction"]) and np.isnan(hole["valid_region_px"]).all()
    assert list(valid_cameras(table)) == ["a", "c"]


def test_a_pinhole_camera_is_its_own_rectified_camera() -> None:
    camera = _camera("a", Pinhole())
    row = _run(_view(camera)).to_pylist()[0]
    assert row["kept_fraction"] == 1.0
    assert row["valid_region_px"] == [0, 0, WIDTH_PX - 1, HEIGHT_PX - 1]
    assert row["round_trip_residual_px"] < 1e-9
    assert row["grid_residual_px"] < 1e-4  # nodes are stored in float32
    target = camera_from_row(row)
    assert np.array_equal(target.K, camera.K)
    assert np.array_equal(target.T_camera_from_world, camera.T_camera_from_world)


def test_focal_scale_follows_the_lens() -> None:
    rows = _run(_view(_camera("a", BARREL)), _view(_camera("b", FISHEYE))).to_pylist()
    perspective, fisheye = (camera_from_row(row) for row in rows)
    assert (perspective.fx_px, perspective.fy_px) == (50.0, 52.0)
    assert (fisheye.fx_px, fisheye.fy_px) == pytest.approx((35.0, 36.4), abs=1e-12)
    assert (fisheye.cx_px, fisheye.cy_px) == (31.0, 24.5)
    assert isinstance(perspective.lens, Pinhole) and isinstance(fisheye.lens, Pinhole)


def test_barrel_distortion_loses_the_corners_of_the_field() -> None:
    row = _run(_view(_camera("a", BARREL))).to_pylist()[0]
    wide = _run(_view(_camera("a", BARREL)), config=CONFIG.model_copy(update={"focal_scale_perspective": 0.7}))
    assert 0.7 < row["kept_fraction"] < 0.75
    assert wide.to_pylist()[0]["kept_fraction"] == 1.0


@pytest.mark.parametrize("lens", [BARREL, FISHEYE])
def test_residuals_are_those_of_the_stored_grid_and_small(lens: Lens) -> None:
    camera = _camera("a", lens)
    row = _run(_view(camera)).to_pylist()[0]
    grid = RemapGrid.from_bytes(row["grid"])
    assert row["grid_residual_px"] == grid.residual_px(camera, camera_from_row(row))
    assert 0 < row["grid_residual_px"] <= CONFIG.max_residual_px
    assert 0 <= row["round_trip_residual_px"] < 1e-8
    assert row["grid_step_px"] == grid.step_px


def test_a_view_that_errs_more_than_allowed_is_refused_with_its_figures() -> None:
    row = _run(_view(_camera("a", BARREL)), config=CONFIG.model_copy(update={"max_residual_px": 1e-6})).to_pylist()[0]
    assert (row["valid"], row["reason"]) == (False, "high_residual")
    assert row["grid_residual_px"] > 1e-6
    assert row["grid"] == b"" and np.isnan(row["intrinsics_px"]).all()


def test_round_trip_residual_sees_a_wrong_inverse() -> None:
    class Wrong(Pinhole):
        def distort(self, rays: np.ndarray) -> np.ndarray:
            return super().distort(rays) + 0.5 / np.array([50.0, 52.0])

    assert round_trip_residual_px(_camera("a", Wrong()), 4) == pytest.approx(0.5 * np.sqrt(2), abs=1e-9)


def _ramp(frame: int) -> np.ndarray:
    """A grey picture whose brightness grows with x in even frames, with y in odd ones, and is higher later on."""
    x, y = np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX))
    return np.repeat((40 + 10 * frame + 2 * (y if frame % 2 else x)).astype(np.uint8)[..., None], 3, axis=2)


def test_materialized_video_shows_the_rectified_picture(tmp_path: Path) -> None:
    source = tmp_path / "raw.mp4"
    with VideoWriter(source, WIDTH_PX, HEIGHT_PX, Fraction(30), crf=0) as video:
        for frame in range(4):
            video.write(_ramp(frame))
    folder = tmp_path / "blobs"
    folder.mkdir()
    camera = _camera("a", BARREL)
    config = CONFIG.model_copy(update={"materialize": True})
    # The sequence has two frames more than this video: they are black.
    row = _run(_view(camera, video=source, num_frames=6), config=config, folder=folder).to_pylist()[0]
    path = folder / row["rectified_file"]
    assert row["rectified_sha256"] == digest_file(path)
    pictures = [picture for _, picture in VideoReader(path).frames(0, 6)]
    target = camera_from_row(row)
    at = np.array([[8, 5], [31, 24], [57, 42]])
    raw_px = camera.project(target.center_world_mm + 700 * target.unproject(at.astype(float)))
    assert np.abs(raw_px - at).max() > 1.8  # an identity would be 3.6 grey levels off
    for frame, picture in enumerate(pictures[:4]):
        expected = 40 + 10 * frame + 2 * raw_px[:, frame % 2]
        seen = picture[at[:, 1], at[:, 0]].mean(axis=1)
        assert np.abs(seen - expected).max() < 2.5  # rounding in two videos; half a pixel would be 1
    assert max(picture.max() for picture in pictures[4:]) < 8
    assert VideoReader(path).num_frames == 6


def test_without_materialize_no_file_is_written(tmp_path: Path) -> None:
    row = _run(_view(_camera("a", BARREL)), folder=tmp_path).to_pylist()[0]
    assert (row["rectified_file"], row["rectified_sha256"]) == ("", "")
    assert list(tmp_path.iterdir()) == []
