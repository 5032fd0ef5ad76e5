"""Recordings with one thing wrong at a time: what can be used is used, everything else says why not."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.catalog import SOURCES
from assemblyhands_core.data.video import VideoReader, VideoWriter
from stages._contract import Context
from stages.ingest import STAGE, IngestConfig, _chunks

WIDTH_PX, HEIGHT_PX, NUM_FRAMES = 64, 48, 12
CONFIG = IngestConfig(
    chunk_frames=5, min_chunks=1, max_frames=None, image_fit="auto", length_unit="auto", max_rate_difference=0.001
)


def _write_video(
    path: Path, num_frames: int = NUM_FRAMES, size_px: tuple[int, int] = (WIDTH_PX, HEIGHT_PX), rate_hz: int = 30
) -> Path:
    noise = np.random.default_rng(num_frames)
    with VideoWriter(path, *size_px, Fraction(rate_hz), crf=10) as video:
        for _ in range(num_frames):
            video.write(noise.integers(60, 256, (size_px[1], size_px[0], 3), dtype=np.uint8))
    return path


def _record(name: str, x_mm: float) -> dict[str, Any]:
    pose = np.eye(4)
    pose[0, 3] = x_mm
    numbers = {f"k{i}": 0.0 for i in range(1, 7)} | {f"p{i}": 0.0 for i in range(1, 5)}
    numbers |= {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "ImageSizeX": WIDTH_PX, "ImageSizeY": HEIGHT_PX}
    return {"Camera": {"SerialNo": name, "DistortionModel": "OpenCV", "ModelViewMatrix": pose.tolist(), **numbers}}


def _calibration(folder: Path, *names: str) -> Path:
    path = folder / "calibration.json"
    path.write_text(json.dumps([_record(name, 100.0 * i) for i, name in enumerate(names)]))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three cameras with a good video each."""
    _calibration(tmp_path, "cam1", "cam2", "cam3")
    for name in ("cam1", "cam2", "cam3"):
        _write_video(tmp_path / f"{name}.mp4")
    return tmp_path


def _run(folder: Path, config: IngestConfig = CONFIG) -> tuple[dict[str, dict[str, Any]], list[dict[str, Any]]]:
    """Views by camera, and chunks; blobs go to ``folder/blobs``."""
    rows = [_source("calibration", folder / "calibration.json")]
    rows += [_source("video", path) for path in sorted(folder.glob("*.mp4"))]
    (folder / "blobs").mkdir(exist_ok=True)
    tables = STAGE.run(config, {"sources": SOURCES.from_rows(rows)}, Context(folder / "blobs", "s", 2))
    views = tables["views"].to_pylist()
    assert len({view["camera_id"] for view in views}) == len(views)
    assert all(view["valid"] == (view["reason"] == "") for view in views)
    assert all(view["valid"] or (view["note"] and np.isnan(view["intrinsics_px"]).all()) for view in views)
    assert list(valid_cameras(tables["views"])) == [view["camera_id"] for view in views if view["valid"]]
    return {view["camera_id"]: view for view in views}, tables["chunks"].to_pylist()


def _source(role: str, path: Path) -> dict[str, str]:
    return {"sequence_id": "s", "role": role, "name": path.stem, "source_file": str(path), "sha256": f"sha {path.name}"}


def _reasons(views: dict[str, dict[str, Any]]) -> dict[str, str]:
    return {name: view["reason"] for name, view in views.items()}


def test_a_good_recording(folder: Path) -> None:
    views, chunks = _run(folder)
    assert _reasons(views) == {"cam1": "", "cam2": "", "cam3": ""}
    for name, view in views.items():
        assert (view["num_frames"], view["rate_hz"], view["image_fit"], view["note"]) == (NUM_FRAMES, 30.0, "same", "")
        assert view["video_sha256"] == f"sha {name}.mp4"
        link = folder / "blobs" / view["video_file"]
        assert link.is_symlink() and link.resolve() == (folder / f"{name}.mp4").resolve()
    assert views["cam3"]["T_camera_from_world"][3] == 200.0
    assert [(chunk["first_frame"], chunk["num_frames"]) for chunk in chunks] == [(0, 5), (5, 5), (10, 2)]


def test_a_missing_video_and_one_of_no_camera_have_a_row_each(folder: Path) -> None:
    (folder / "cam2.mp4").rename(folder / "garden.mp4")
    views, _ = _run(folder)
    assert _reasons(views) == {"cam1": "", "cam2": "missing_video", "cam3": "", "garden": "no_calibration"}
    assert views["cam2"]["video_file"] == "" and (folder / "blobs" / views["garden"]["video_file"]).exists()


def test_two_videos_of_one_camera_are_not_chosen_between(folder: Path) -> None:
    _write_video(folder / "take2-cam2.mp4")
    views, _ = _run(folder)
    expected = {"cam1": "", "cam2": "missing_video", "cam3": ""}
    # The camera's name is taken by the camera itself, so its video goes by the file's.
    assert _reasons(views) == expected | {"cam2.mp4": "no_calibration", "take2-cam2": "no_calibration"}
    assert "cam2" in views["take2-cam2"]["note"]


def test_a_truncated_video_is_used_for_the_frames_that_it_has(folder: Path) -> None:
    path = folder / "cam2.mp4"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    views, chunks = _run(folder)
    assert _reasons(views) == {"cam1": "", "cam2": "", "cam3": ""}
    there = views["cam2"]["num_frames"]
    assert 0 < there < NUM_FRAMES and there == VideoReader(path).num_frames
    assert f"lacks the frames {there} to {NUM_FRAMES - 1}" in views["cam2"]["note"]
    assert "breaks off" in views["cam2"]["note"]
    assert sum(chunk["num_frames"] for chunk in chunks) == NUM_FRAMES


def test_an_unreadable_video_is_left_out(folder: Path) -> None:
    (folder / "cam2.mp4").write_bytes(b"this is no video" * 100)
    views, _ = _run(folder)
    assert _reasons(views) == {"cam1": "", "cam2": "unreadable_video", "cam3": ""}
    assert "cam2.mp4" in views["cam2"]["note"] and views["cam2"]["num_frames"] == 0


def test_a_video_of_another_shape_is_left_out_one_of_the_same_shape_is_scaled(folder: Path) -> None:
    _write_video(folder / "cam2.mp4", size_px=(40, 48))
    _write_video(folder / "cam3.mp4", size_px=(32, 24))
    views, _ = _run(folder)
    assert _reasons(views) == {"cam1": "", "cam2": "image_size_mismatch", "cam3": ""}
    assert "40x48" in views["cam2"]["note"]
    small = views["cam3"]
    assert (small["image_fit"], small["width_px"], small["height_px"]) == ("scaled", 32, 24)
    assert small["intrinsics_px"] == [30.0, 30.0, 15.5, 11.5]  # (31.5 + 0.5) / 2 - 0.5


def test_the_users_word_on_the_image_fit_that_is_impossible_costs_that_view_only(folder: Path) -> None:
    _write_video(folder / "cam2.mp4", size_px=(40, 48))
    views, _ = _run(folder, CONFIG.model_copy(update={"image_fit": "same"}))
    assert _reasons(views) == {"cam1": "", "cam2": "image_size_mismatch", "cam3": ""}


def test_a_view_of_another_frame_rate_is_left_out(folder: Path) -> None:
    _write_video(folder / "cam1.mp4", num_frames=2 * NUM_FRAMES, rate_hz=60)
    views, chunks = _run(folder)
    assert _reasons(views) == {"cam1": "different_rate", "cam2": "", "cam3": ""}
    assert "60.000 Hz" in views["cam1"]["note"] and "30.000 Hz" in views["cam1"]["note"]
    assert sum(chunk["num_frames"] for chunk in chunks) == NUM_FRAMES


def test_the_sequence_is_as_long_as_the_median_view(folder: Path) -> None:
    _write_video(folder / "cam1.mp4", num_frames=20)
    _write_video(folder / "cam2.mp4", num_frames=3)
    views, chunks = _run(folder)
    assert {name: view["num_frames"] for name, view in views.items()} == {"cam1": 12, "cam2": 3, "cam3": 12}
    assert sum(chunk["num_frames"] for chunk in chunks) == 12
    assert "lacks the frames 3 to 11" in views["cam2"]["note"]


def test_max_frames_ends_the_sequence_early(folder: Path) -> None:
    views, chunks = _run(folder, CONFIG.model_copy(update={"max_frames": 7}))
    assert [view["num_frames"] for view in views.values()] == [7, 7, 7]
    assert [(chunk["first_frame"], chunk["num_frames"]) for chunk in chunks] == [(0, 5), (5, 2)]


def test_less_than_two_usable_views_end_with_all_reasons(folder: Path) -> None:
    (folder / "cam1.mp4").unlink()
    (folder / "cam2.mp4").write_bytes(b"no video")
    with pytest.raises(ValueError, match=r"1 usable view.*cam1 \(missing_video.*cam2 \(unreadable_video.*cam2\.mp4"):
        _run(folder)


def test_a_calibration_with_nan_is_refused_with_file_and_camera(folder: Path) -> None:
    path = folder / "calibration.json"
    path.write_text(path.read_text().replace("60.0", "NaN", 1))
    with pytest.raises(ValueError, match=r"calibration\.json.*cam1.*fx") as caught:
        _run(folder)
    assert "\n" not in str(caught.value)


def test_a_sequence_has_exactly_one_calibration(tmp_path: Path) -> None:
    sources = SOURCES.from_rows([_source("video", tmp_path / "cam1.mp4")])
    with pytest.raises(ValueError, match="sequence s has 0 calibration files"):
        STAGE.run(CONFIG, {"sources": sources}, Context(tmp_path, "s"))


@settings(derandomize=True, deadline=None, max_examples=40)
@given(num_frames=st.integers(1, 1000), chunk_frames=st.integers(1, 300), min_chunks=st.integers(1, 8))
def test_chunks_cover_every_frame_once(num_frames: int, chunk_frames: int, min_chunks: int) -> None:
    config = CONFIG.model_copy(update={"chunk_frames": chunk_frames, "min_chunks": min_chunks})
    chunks = list(_chunks(config, num_frames, Context(Path(), "s")))
    frames = [chunk["first_frame"] + i for chunk in chunks for i in range(chunk["num_frames"])]
    assert frames == list(range(num_frames))
    assert [chunk["chunk"] for chunk in chunks] == list(range(len(chunks)))


@pytest.mark.parametrize(
    ("num_frames", "lengths"), [(100, [25] * 4), (10, [3, 3, 3, 1]), (600, [128] * 4 + [88]), (2, [1, 1])]
)
def test_a_short_sequence_is_cut_finer(num_frames: int, lengths: list[int]) -> None:
    config = CONFIG.model_copy(update={"chunk_frames": 128, "min_chunks": 4})
    assert [chunk["num_frames"] for chunk in _chunks(config, num_frames, Context(Path(), "s"))] == lengths
