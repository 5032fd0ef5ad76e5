"""From a headset's files to crops: a fisheye video from a moving head, where every bright spot's place is known."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.assemblyhands import RECTIFIED_FOCAL_SCALE, EgoCalibration, write_ego_calibration
from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.hands.joints import HANDS, WRIST
from assemblyhands_core.synthetic.rig import Rig, assembly_rig
from stages._contract import Context
from stages.ingest_ego import STAGE as INGEST_EGO
from stages.ingest_ego import IngestEgoConfig
from stages.project_ego import STAGE, ProjectEgoConfig
from stages.undistort import STAGE as UNDISTORT
from stages.undistort import UndistortConfig

RECORDING, NUM_FRAMES = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830", 4
CONFIG = ProjectEgoConfig(
    gamma=1.75, size_px=256, jpeg_quality=95, min_joints=15, min_border_px=0.0, min_other_share=0.5
)
UNDISTORTED = UndistortConfig(
    focal_scale_perspective=1.0,
    focal_scale_fisheye=0.7,
    grid_step_px=8,
    lattice_step_px=16,
    max_residual_px=0.02,
    materialize=False,
    video_crf=18,
)


def _heads() -> list[np.ndarray]:
    """T_headset_from_world: the head moves sideways by a centimetre a frame."""
    poses = np.tile(np.eye(4), (NUM_FRAMES, 1, 1))
    poses[:, 0, 3] = -10.0 * np.arange(NUM_FRAMES)
    return list(poses)


def _hands(camera: Camera) -> np.ndarray:
    """Joints (2, 21, 3) before a camera: grids of a few centimetres, 30 cm and 35 cm away, apart from one another."""
    offsets = np.stack([10.0 * (np.arange(21) % 5) - 20.0, 10.0 * (np.arange(21) // 5) - 20.0, 2.0 * np.arange(21)], -1)
    at_camera = offsets + np.array([[[60.0, 10.0, 300.0]], [[-90.0, -20.0, 350.0]]])
    T_world_from_camera = np.linalg.inv(camera.T_camera_from_world)
    return at_camera @ T_world_from_camera[:3, :3].T + T_world_from_camera[:3, 3]


def _spots(camera: Camera, joints: np.ndarray) -> np.ndarray:
    """A dark picture with a soft spot at the wrist of either hand."""
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    picture = np.full(x.shape, 10.0)
    for u, v in camera.project(joints[:, WRIST]):
        picture += 230 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.0**2))
    return np.repeat(picture.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return assembly_rig(20220302)


@pytest.fixture(scope="module")
def joints(rig: Rig) -> np.ndarray:
    """Joints (2, 21, 3), the same at all frames, seen by the headset's first camera."""
    return _hands(next(iter(rig.ego_at(_heads()[0]).values())))


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory, rig: Rig, joints: np.ndarray) -> pa.Table:
    """The files of a recording whose first camera has a video, whose third frame has no pose of it."""
    folder = tmp_path_factory.mktemp("headset")
    calibration, ego_file = folder / "calibration.json", folder / "ego.json"
    write_assembly101_calibration(calibration, [*rig.exo.values(), *rig.ego.values()])
    at = [rig.ego_at(head) for head in _heads()]
    poses = np.array([[camera.T_camera_from_world for camera in cameras.values()] for cameras in at])
    poses[2, 0] = np.nan
    K = np.array([rectified(camera, RECTIFIED_FOCAL_SCALE).K for camera in rig.ego.values()])
    write_ego_calibration(ego_file, {RECORDING: EgoCalibration(tuple(rig.ego), K, 2 * np.arange(NUM_FRAMES), poses)})
    name = next(iter(rig.ego))
    video_file = folder / f"{name}.mp4"
    with VideoWriter(video_file, rig.ego[name].width_px, rig.ego[name].height_px, Fraction(30), crf=4) as video:
        for cameras in at:
            video.write(_spots(cameras[name], joints))
    files = [("calibration", "calibration", calibration), ("ego_calibration", "ego_calibration", ego_file)]
    files.append(("ego_video", name, video_file))
    row = {"sequence_id": RECORDING, "sha256": ""}
    return SOURCES.from_rows([row | {"role": r, "name": n, "source_file": str(path)} for r, n, path in files])


@pytest.fixture(scope="module")
def headset(sources: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    context = Context(tmp_path_factory.mktemp("blobs"), RECORDING)
    found = dict(INGEST_EGO.run(IngestEgoConfig(chunk_frames=3), {"sources": sources}, context))
    rows = found["views"].to_pylist()
    for row in rows:
        row["video_file"] = str(context.blob_dir / row["video_file"]) if row["video_file"] else ""
    views = VIEWS.from_rows(rows)
    rectified_views = UNDISTORT.run(UNDISTORTED, {"views": views}, context)["rectified_views"]
    return {"views": views, "frames": found["frames"], "boxes": found["boxes"], "rectified_views": rectified_views}


def _annotation(joints: np.ndarray, frames: range = range(NUM_FRAMES)) -> pa.Table:
    rows = [
        {
            "sequence_id": RECORDING,
            "frame": frame,
            "hand": hand,
            "joints_world_mm": points.ravel(),
            "valid": np.isfinite(points).all(axis=-1),
            "reason": [""] * 21,
            "num_views": np.full(21, 8),
            "reprojection_px": np.zeros(21),
            "source": "svegonet" if hand == "left" else "mvexonet",
            "round": 3,
        }
        for frame in frames
        for hand, points in zip(HANDS, joints, strict=True)
    ]
    return JOINTS.from_rows(rows)


def _run(
    headset: dict[str, pa.Table], annotation: pa.Table, config: ProjectEgoConfig = CONFIG
) -> dict[tuple[int, str], dict[str, Any]]:
    chunk = CHUNKS.from_rows([{"sequence_id": RECORDING, "chunk": 0, "first_frame": 0, "num_frames": 9}])
    inputs = {**headset, "chunks": chunk, "joints": annotation}
    rows = STAGE.run(config, inputs, Context(Path(), RECORDING))["crops"].to_pylist()
    return {(row["frame"], row["hand"]): row for row in rows}


def test_every_camera_has_a_row_and_those_without_video_say_so(headset: dict[str, pa.Table], rig: Rig) -> None:
    rows = {row["camera_id"]: row for row in headset["views"].to_pylist()}
    assert list(rows) == list(rig.ego)
    first, *others = rows.values()
    assert first["valid"] and first["num_frames"] == NUM_FRAMES and first["lens_model"] == "OVFishEye62"
    assert {row["reason"] for row in others} == {"missing_video"}
    frames = headset["frames"].to_pylist()
    assert [row["reason"] for row in frames] == ["", "", "no_pose", ""]
    expected = next(iter(rig.ego_at(_heads()[3]).values())).T_camera_from_world
    np.testing.assert_allclose(np.reshape(frames[3]["T_camera_from_world"], (4, 4)), expected, rtol=0, atol=1e-12)


def test_a_crop_shows_the_hand_where_its_labels_say(headset: dict[str, pa.Table], joints: np.ndarray) -> None:
    rows = _run(headset, _annotation(joints))
    assert len(rows) == 2 * NUM_FRAMES
    for (frame, hand), row in rows.items():
        if frame == 2:
            assert (row["valid"], row["reason"]) == (False, "no_pose")
            continue
        assert row["valid"] and row["identity"] == hand
        image, own = decode_image(row["image"]).mean(axis=2), HANDS.index(hand)
        weight = (image - 40).clip(0)
        y, x = (np.arange(side) for side in image.shape)
        light = np.array([weight.sum(0) @ x, weight.sum(1) @ y]) / weight.sum()
        wrist_px = np.reshape(row["joints_px"], (2, 21, 2))[own, WRIST]
        np.testing.assert_allclose(light, wrist_px, rtol=0, atol=0.3)
        camera = camera_from_row(row)
        np.testing.assert_allclose(camera.project(joints[own, WRIST]), wrist_px, rtol=0, atol=1e-2)
        in_camera = np.reshape(row["joints_camera_mm"], (2, 21, 3))
        np.testing.assert_allclose(in_camera, camera.to_camera(joints), rtol=0, atol=1e-2)
        relative = np.reshape(row["joints_wrist_relative_mm"], (2, 21, 3))
        np.testing.assert_allclose(relative, in_camera - in_camera[:, [WRIST]], rtol=0, atol=1e-3)
        assert (
            np.reshape(row["is_labelled"], (2, 21))[own].all()
            and not np.reshape(row["is_labelled"], (2, 21))[1 - own].all()
        )
        assert row["source"] == ("svegonet" if hand == "left" else "mvexonet")


def test_hands_that_give_no_crop_are_counted_by_reason(headset: dict[str, pa.Table], joints: np.ndarray) -> None:
    unknown = joints.copy()
    unknown[1] = np.nan
    rows = _run(headset, _annotation(unknown, range(1)))
    assert rows[0, "right"]["valid"] and rows[0, "left"]["reason"] == "unknown_hand"
    behind = joints.copy()
    camera = next(iter(headset["frames"].to_pylist()))
    pose = np.reshape(camera["T_camera_from_world"], (4, 4))
    behind[0] += np.linalg.inv(pose)[:3, :3] @ [0.0, 0.0, -600.0]
    assert _run(headset, _annotation(behind, range(1)))[0, "right"]["reason"] == "behind_camera"
    assert not _run(headset, _annotation(joints, range(9, 11))), "another chunk's frames"
    beyond = _run(headset, _annotation(joints, range(NUM_FRAMES, NUM_FRAMES + 1)))
    assert {row["reason"] for row in beyond.values()} == {"no_pose"}
    strict = _run(headset, _annotation(joints, range(1)), CONFIG.model_copy(update={"min_border_px": 400.0}))
    assert {row["reason"] for row in strict.values()} == {"near_border"}


def test_hands_that_meet_are_in_one_crop(headset: dict[str, pa.Table], joints: np.ndarray) -> None:
    together = np.stack([joints[0], joints[0] + 5.0])
    rows = _run(headset, _annotation(together, range(1)))
    assert {row["identity"] for row in rows.values()} == {"both"}
    assert all(np.all(row["is_labelled"]) for row in rows.values())


def test_a_sequence_that_its_headsets_file_lacks_is_named(sources: pa.Table, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ego\.json has no recording other"):
        INGEST_EGO.run(IngestEgoConfig(chunk_frames=3), {"sources": sources}, Context(tmp_path, "other"))
