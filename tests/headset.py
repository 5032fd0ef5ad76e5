"""A headset for tests: a fisheye video from a moving head, where every bright spot's place is known."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pyarrow as pa
from finished_run import write_table

from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.assemblyhands import RECTIFIED_FOCAL_SCALE, EgoCalibration, write_ego_calibration
from assemblyhands_core.data.catalog import CHUNKS, JOINTS, RECTIFIED_VIEWS, SOURCES, VIEWS
from assemblyhands_core.data.ego_tables import EGO_BOXES, EGO_FRAMES
from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.crops import rectified
from assemblyhands_core.hands.joints import HANDS, WRIST
from assemblyhands_core.synthetic.rig import Rig
from stages._contract import Context
from stages.ingest_ego import STAGE as INGEST_EGO
from stages.ingest_ego import IngestEgoConfig
from stages.undistort import STAGE as UNDISTORT
from stages.undistort import UndistortConfig

RECORDING, NUM_FRAMES = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830", 4
CHUNK = CHUNKS.from_rows([{"sequence_id": RECORDING, "chunk": 0, "first_frame": 0, "num_frames": 9}])
UNDISTORTED = UndistortConfig(
    focal_scale_perspective=1.0,
    focal_scale_fisheye=0.7,
    grid_step_px=8,
    lattice_step_px=16,
    max_residual_px=0.02,
    materialize=False,
    video_crf=18,
)


def heads() -> list[np.ndarray]:
    """T_headset_from_world: the head moves sideways by a centimetre a frame."""
    poses = np.tile(np.eye(4), (NUM_FRAMES, 1, 1))
    poses[:, 0, 3] = -10.0 * np.arange(NUM_FRAMES)
    return list(poses)


def hands_before(camera: Camera) -> np.ndarray:
    """Joints (2, 21, 3) before a camera: grids of a few centimetres, 30 cm and 35 cm away, apart from one another."""
    offsets = np.stack([10.0 * (np.arange(21) % 5) - 20.0, 10.0 * (np.arange(21) // 5) - 20.0, 2.0 * np.arange(21)], -1)
    at_camera = offsets + np.array([[[60.0, 10.0, 300.0]], [[-90.0, -20.0, 350.0]]])
    T_world_from_camera = np.linalg.inv(camera.T_camera_from_world)
    return at_camera @ T_world_from_camera[:3, :3].T + T_world_from_camera[:3, 3]


def spots(camera: Camera, joints: np.ndarray) -> np.ndarray:
    """A dark picture with a soft spot at the wrist of either hand."""
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    picture = np.full(x.shape, 10.0)
    for u, v in camera.project(joints[:, WRIST]):
        picture += 230 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.0**2))
    return np.repeat(picture.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def write_headset(folder: Path, rig: Rig, joints: np.ndarray) -> pa.Table:
    """Write the files of a recording whose first camera has a video, whose third frame has no pose of it."""
    calibration, ego_file = folder / "calibration.json", folder / "ego.json"
    write_assembly101_calibration(calibration, [*rig.exo.values(), *rig.ego.values()])
    at = [rig.ego_at(head) for head in heads()]
    poses = np.array([[camera.T_camera_from_world for camera in cameras.values()] for cameras in at])
    poses[2, 0] = np.nan
    K = np.array([rectified(camera, RECTIFIED_FOCAL_SCALE).K for camera in rig.ego.values()])
    write_ego_calibration(ego_file, {RECORDING: EgoCalibration(tuple(rig.ego), K, 2 * np.arange(NUM_FRAMES), poses)})
    name = next(iter(rig.ego))
    video_file = folder / f"{name}.mp4"
    with VideoWriter(video_file, rig.ego[name].width_px, rig.ego[name].height_px, Fraction(30), crf=4) as video:
        for cameras in at:
            video.write(spots(cameras[name], joints))
    files = [("calibration", "calibration", calibration), ("ego_calibration", "ego_calibration", ego_file)]
    files.append(("ego_video", name, video_file))
    row = {"sequence_id": RECORDING, "sha256": ""}
    return SOURCES.from_rows([row | {"role": r, "name": n, "source_file": str(path)} for r, n, path in files])


def ingested(sources: pa.Table, folder: Path) -> dict[str, pa.Table]:
    """Return what the stages that crop the headset's pictures read, but for joints."""
    context = Context(folder, RECORDING)
    found = dict(INGEST_EGO.run(IngestEgoConfig(chunk_frames=3, first_key=None), {"sources": sources}, context))
    rows = found["views"].to_pylist()
    for row in rows:
        row["video_file"] = str(context.blob_dir / row["video_file"]) if row["video_file"] else ""
    views = VIEWS.from_rows(rows)
    rectified_views = UNDISTORT.run(UNDISTORTED, {"views": views}, context)["rectified_views"]
    return {**found, "views": views, "rectified_views": rectified_views, "chunks": CHUNK}


def annotation(joints: np.ndarray, frames: range = range(NUM_FRAMES)) -> pa.Table:
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


def write_run(run: Path, rig: Rig, joints: np.ndarray) -> None:
    """Write the run of a recording that has a headset alone, annotated by people."""
    files = run.with_name("files")
    for folder in (run, files):
        folder.mkdir(parents=True)
    tables = ingested(write_headset(files, rig, joints), run)
    specs = {"views": VIEWS, "chunks": CHUNKS, "frames": EGO_FRAMES, "boxes": EGO_BOXES, "joints": JOINTS}
    for name, spec in specs.items():
        table = annotation(joints) if name == "joints" else tables[name]
        write_table(run / "ingest_ego" / name / f"{RECORDING}.parquet", spec, table)
    rectified_views = tables["rectified_views"]
    write_table(run / "undistort_ego" / "rectified_views" / f"{RECORDING}.parquet", RECTIFIED_VIEWS, rectified_views)
