"""Hand regions cut from small videos in which the place of every bright spot is known."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from headset import UNDISTORTED

from assemblyhands_core.data.camera_rows import camera_from_row, camera_to_row, missing_camera_row
from assemblyhands_core.data.catalog import CHUNKS, HAND_BOXES, VIEWS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens, Pinhole
from stages._contract import Context
from stages.crop_hands import STAGE, CropHandsConfig
from stages.undistort import STAGE as UNDISTORT

WIDTH_PX, HEIGHT_PX, NUM_FRAMES, RADIUS_MM = 320, 240, 5, 100.0
CONFIG = CropHandsConfig(margin=1.5, size_px=384, jpeg_quality=95)


def _camera(name: str, angle_rad: float) -> Camera:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose = np.array([[c, 0, s, 5], [0, 1, 0, -10], [-s, 0, c, 800], [0, 0, 0, 1.0]])
    return Camera(name, WIDTH_PX, HEIGHT_PX, 250.0, 252.0, 158.0, 121.0, OpenCVLens(k1=-0.3, k2=0.05, p1=2e-3), pose)


CAMERAS = [_camera("a", 0.0), _camera("b", 0.7)]
# Where the hands are in each frame; off the middle, where the lens bends most.
HANDS_MM = {("right", frame): np.array([-180.0 + 10 * frame, 120.0, 30.0]) for frame in range(NUM_FRAMES)} | {
    ("left", frame): np.array([190.0, -90.0 - 10 * frame, -20.0]) for frame in range(NUM_FRAMES)
}


def _spots(camera: Camera, frame: int) -> np.ndarray:
    """A grey picture with a soft spot at either hand."""
    x, y = np.meshgrid(np.arange(WIDTH_PX), np.arange(HEIGHT_PX))
    picture = np.full((HEIGHT_PX, WIDTH_PX), 20.0)
    for hand in ("right", "left"):
        u, v = camera.project(HANDS_MM[hand, frame])
        picture += 200 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 3.0**2))
    return np.repeat(picture.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    folder, rows = tmp_path_factory.mktemp("videos"), []
    for camera in CAMERAS:
        path = folder / f"{camera.camera_id}.mp4"
        with VideoWriter(path, WIDTH_PX, HEIGHT_PX, Fraction(30), crf=5) as video:
            for frame in range(NUM_FRAMES):
                video.write(_spots(camera, frame))
        rows.append(_view(camera.camera_id, camera, str(path)))
    return VIEWS.from_rows([*rows, _view("c", None, "")])


def _view(name: str, camera: Camera | None, path: str) -> dict[str, Any]:
    row = {"sequence_id": "s", "camera_id": name, "video_file": path, "video_sha256": "", "num_frames": NUM_FRAMES}
    row |= {"rate_hz": 30.0, "image_fit": "same", "note": ""}
    row |= camera_to_row(camera) if camera else missing_camera_row()
    return row | {"valid": camera is not None, "reason": "" if camera else "missing_video"}


@pytest.fixture(scope="module")
def rectified(views: pa.Table) -> pa.Table:
    return UNDISTORT.run(UNDISTORTED, {"views": views}, Context(Path(), "s"))["rectified_views"]


def _boxes(rectified: pa.Table, num_frames: int = NUM_FRAMES) -> list[dict[str, Any]]:
    """A box around each hand in each view, off its centre by some pixels; holes in the view without camera."""
    rows = []
    for frame in range(num_frames):
        for hand in ("right", "left"):
            center_mm = HANDS_MM[hand, min(frame, NUM_FRAMES - 1)]
            for view in rectified.to_pylist():
                row = {"sequence_id": "s", "frame": frame, "hand": hand, "camera_id": view["camera_id"]}
                row |= {"hand_center_world_mm": center_mm, "source": "detected"}
                row |= {"center_rectified_px": np.full(2, np.nan), "side_px": np.nan}
                row |= {"valid": view["valid"], "reason": view["reason"]}
                if view["valid"]:
                    camera = camera_from_row(view)
                    row["center_rectified_px"] = camera.project(center_mm) + np.array([3.3, -4.4])
                    row["side_px"] = 2 * RADIUS_MM * camera.fx_px / camera.depth_mm(center_mm)
                rows.append(row)
    return rows


def _run(
    views: pa.Table,
    rectified: pa.Table,
    boxes: list[dict[str, Any]],
    config: CropHandsConfig = CONFIG,
    first: int = 0,
    count: int = NUM_FRAMES,
) -> list[dict[str, Any]]:
    chunk = {"sequence_id": "s", "chunk": 0, "first_frame": first, "num_frames": count}
    inputs = {
        "chunks": CHUNKS.from_rows([chunk]),
        "views": views,
        "rectified_views": rectified,
        "hand_boxes": HAND_BOXES.from_rows(boxes),
    }
    return STAGE.run(config, inputs, Context(Path(), "s"))["crops"].to_pylist()


def _center_of_light(image: np.ndarray) -> np.ndarray:
    weight = (image.mean(axis=2) - 40).clip(0)
    y, x = np.indices(weight.shape)
    return np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("size_px", [384, 40, 21])
def test_what_is_drawn_at_a_point_lies_where_the_crops_camera_projects_it(
    views: pa.Table, rectified: pa.Table, size_px: int
) -> None:
    config = CONFIG.model_copy(update={"size_px": size_px})
    crops = [row for row in _run(views, rectified, _boxes(rectified), config) if row["valid"]]
    assert len(crops) == NUM_FRAMES * 2 * len(CAMERAS)
    for crop in crops:
        camera, image = camera_from_row(crop), decode_image(crop["image"])
        assert isinstance(camera.lens, Pinhole) and image.shape == (camera.height_px, camera.width_px, 3)
        expected = camera.project(HANDS_MM[crop["hand"], crop["frame"]])
        assert np.linalg.norm(_center_of_light(image) - expected) < 0.25, (crop["camera_id"], crop["frame"])


def test_a_region_has_the_margin_and_no_more_pixels_than_the_video(views: pa.Table, rectified: pa.Table) -> None:
    boxes = _boxes(rectified)
    crop, box = _run(views, rectified, boxes)[0], boxes[0]
    side_px = 1.5 * np.float32(box["side_px"])
    camera, whole = camera_from_row(crop), camera_from_row(rectified.to_pylist()[0])
    assert crop["width_px"] == crop["height_px"] == int(np.ceil(side_px)) < CONFIG.size_px
    assert camera.fx_px / whole.fx_px == pytest.approx(crop["width_px"] / side_px, rel=1e-6)
    middle_px = camera.project(whole.center_world_mm + whole.unproject(np.float32(box["center_rectified_px"]) * 1.0))
    assert middle_px == pytest.approx([crop["width_px"] / 2 - 0.5] * 2, abs=1e-3)


def test_a_shrunk_region_is_averaged_not_picked(tmp_path: Path) -> None:
    """Stripes one pixel wide shrink to an even grey; picking every n-th pixel would leave stripes or lose them."""
    camera = Camera("a", 64, 64, 60.0, 60.0, 31.5, 31.5, Pinhole(), _camera("a", 0).T_camera_from_world)
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::2] = 200
    with VideoWriter(tmp_path / "a.mp4", 64, 64, Fraction(30), crf=0) as video:
        video.write(stripes)
    views = VIEWS.from_rows([_view("a", camera, str(tmp_path / "a.mp4"))])
    config = UNDISTORTED.model_copy(update={"focal_scale_fisheye": 1.0})
    rectified = UNDISTORT.run(config, {"views": views}, Context(tmp_path, "s"))["rectified_views"]
    box = {**_boxes(rectified, 1)[0], "center_rectified_px": np.array([31.5, 31.5]), "side_px": 64.0}
    crop = _run(views, rectified, [box], CONFIG.model_copy(update={"margin": 1.0, "size_px": 32}))[0]
    image = decode_image(crop["image"])[2:-2, 2:-2]
    assert abs(float(image.mean()) - 100) < 4 and np.ptp(image) < 12


def test_rows_are_those_of_the_boxes_with_every_hole_named(views: pa.Table, rectified: pa.Table) -> None:
    boxes = _boxes(rectified, num_frames=NUM_FRAMES + 2)  # two more than the videos have
    boxes[0] |= {"valid": False, "reason": "no_detection"}
    boxes[1] |= {"center_rectified_px": np.array([-900.0, 100.0])}
    crops = _run(views, rectified, boxes, count=NUM_FRAMES + 2)
    names = [tuple(row[key] for key in HAND_BOXES.key) for row in boxes]
    assert [tuple(row[key] for key in HAND_BOXES.key) for row in crops] == names
    reasons = [row["reason"] for row in crops]
    assert reasons[:3] == ["no_detection", "outside_view", "missing_video"]
    assert reasons.count("missing_video") == 2 * (NUM_FRAMES + 2)
    assert reasons.count("missing_frame") == 2 * 2 * len(CAMERAS)
    assert reasons.count("") == 2 * NUM_FRAMES * len(CAMERAS) - 2
    for row in crops:
        assert row["valid"] == (row["reason"] == "") == bool(row["image"])
        assert row["valid"] or np.isnan(row["intrinsics_px"]).all()


def test_a_region_over_the_edge_is_kept_with_black_beyond(views: pa.Table, rectified: pa.Table) -> None:
    raw, whole = CAMERAS[0], camera_from_row(rectified.to_pylist()[0])
    edge_px = whole.project(raw.center_world_mm + 500 * raw.unproject(np.array([-0.5, 121.0])))
    crop = _run(views, rectified, [{**_boxes(rectified)[0], "center_rectified_px": edge_px}])[0]
    assert crop["valid"]
    line = decode_image(crop["image"])[crop["height_px"] // 2].mean(axis=1)
    middle = crop["width_px"] // 2
    assert line[: middle - 3].max() < 6 and line[middle + 3 :].min() > 14  # the videos' ground is 20


def test_a_chunk_takes_its_own_frames_and_cuts_them_alike(views: pa.Table, rectified: pa.Table) -> None:
    boxes = _boxes(rectified)
    whole = _run(views, rectified, boxes)
    parts = [row for first in (0, 2, 4) for row in _run(views, rectified, boxes, first=first, count=2)]
    assert len(parts) == len(whole)
    assert all(a["image"] == b["image"] and a["frame"] == b["frame"] for a, b in zip(whole, parts, strict=True))


def test_no_boxes_give_an_empty_table(views: pa.Table, rectified: pa.Table) -> None:
    assert _run(views, rectified, []) == []
