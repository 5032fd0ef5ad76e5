"""The studio by its command line: files as the real data sets have them, that give back what was simulated."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, digests, entries, new_stages, pipeline

from assemblyhands_core.data.assemblyhands import read_ego_calibration, read_joint_annotations
from assemblyhands_core.data.fine_grained import read_fine_grained
from assemblyhands_core.data.ground_truth import TRUE_INSTANTS, TRUE_JOINTS, TRUE_VIEWS, read_ground_truth
from assemblyhands_core.data.layout import DatasetLayout, read_split
from assemblyhands_core.data.names import ego_calibration_name
from assemblyhands_core.data.store import load
from assemblyhands_core.data.video import VideoReader, probe
from assemblyhands_core.geometry.cameras import load_assembly101_calibration
from assemblyhands_core.synthetic.session import Order, Session

NAME = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"
NUM_FRAMES = 2
ORDER = Order(NAME, "assembly", NUM_FRAMES / 30)


@dataclass(frozen=True)
class Recorded:
    """What `simulate` left behind."""

    outcome: Outcome
    workspace: Path
    overrides: tuple[str, ...]

    @property
    def layout(self) -> DatasetLayout:
        return DatasetLayout(self.workspace / "synthetic")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("studio")
    header = "sequence_id,split,calibration,videos,package,rig,duration_s,ground_truth"
    row = f"{NAME},test,calib/nimble_json_calib/{NAME}.json,recordings/{NAME}/*_rgb.mp4,synthetic,assembly,"
    row += f"{ORDER.duration_s},ground_truth/{NAME}"
    (folder / "set.csv").write_text(f"{header}\n{row}\n")
    overrides = (f"manifest={folder / 'set.csv'}", "seq=all", "script_take.chunk_frames=1")
    outcome = pipeline("simulate", "executor=serial", *overrides, workspace=folder / "work")
    return Recorded(outcome.assert_done(), folder / "work", overrides)


@pytest.fixture(scope="module")
def session() -> Session:
    return Session(ORDER)


def test_the_files_are_where_the_real_data_sets_have_them(recorded: Recorded, session: Session) -> None:
    layout = recorded.layout
    assert f"recorded: {NAME}" in recorded.outcome.said
    videos = {camera_id: layout.video(NAME, camera_id) for camera_id in session.camera_ids}
    assert len(videos) == 12 and all(probe(path).num_frames == NUM_FRAMES for path in videos.values())
    assert (probe(videos["C10095_rgb"]).width_px, probe(videos["C10095_rgb"]).height_px) == (1920, 1080)
    assert read_split(layout.split("test")) == [NAME]
    listed = {line.split("  ")[1] for line in layout.delivered(NAME).read_text().splitlines()[1:]}
    there = {path.relative_to(layout.root).as_posix() for path in layout.root.rglob("*") if path.is_file()}
    assert listed <= there and len(listed) == 12 + 1 + 3 + 3


def test_the_calibration_gives_back_the_cameras(recorded: Recorded, session: Session) -> None:
    path = recorded.layout.calibration(NAME)
    cameras = load_assembly101_calibration(path)
    for name, camera in {**session.rig.exo, **session.rig.ego}.items():
        read = cameras[name if name in session.rig.exo else ego_calibration_name(name)]
        assert np.array_equal(read.T_camera_from_world, camera.T_camera_from_world)
        assert np.array_equal(read.K, camera.K) and read.lens == camera.lens
    blocks = json.loads(path.read_text())
    assert [block["Camera"]["SerialNo"] for block in blocks] != list(session.rig.exo | session.rig.ego), "shuffled"


def test_the_truth_is_the_simulators(recorded: Recorded, session: Session) -> None:
    folder = recorded.layout.ground_truth(NAME)
    joints, views, instants = (read_ground_truth(folder, spec) for spec in (TRUE_JOINTS, TRUE_VIEWS, TRUE_INSTANTS))
    assert (joints.num_rows, views.num_rows, instants.num_rows) == (2 * NUM_FRAMES, 24 * NUM_FRAMES, NUM_FRAMES)
    for row in joints.to_pylist():
        state = session.take.state_at(row["frame"] / 30)
        expected = state.joints_world_mm.reshape(2, 63)[0 if row["hand"] == "right" else 1]
        np.testing.assert_allclose(row["joints_world_mm"], expected, atol=1e-4)
    ego = read_ego_calibration(recorded.layout.annotations("test", "ego_calib"))[NAME]
    raw = load_assembly101_calibration(recorded.layout.calibration(NAME))
    for frame in range(NUM_FRAMES):
        pose = session.take.state_at(frame / 30).T_headset_from_world
        for name, camera in session.rig.ego_at(pose).items():
            read = ego.raw_at(2 * frame, raw)[name]
            np.testing.assert_allclose(read.T_camera_from_world, camera.T_camera_from_world, atol=1e-9)
            row = next(
                v for v in views.to_pylist() if (v["frame"], v["camera_id"], v["hand"]) == (frame, name, "right")
            )
            points = session.take.state_at(frame / 30).joints_world_mm[:21]
            np.testing.assert_allclose(np.array(row["joints_px"]).reshape(21, 2), read.project(points), atol=0.01)


def test_labels_are_the_truth_with_an_annotators_noise(recorded: Recorded, session: Session) -> None:
    labels = read_joint_annotations(recorded.layout.annotations("test", "joint_3d"))[NAME]
    assert labels.frames_60hz.tolist() == [0]
    errors = labels.joints_world_mm[0] - session.take.state_at(0.0).joints_world_mm.reshape(2, 21, 3)
    assert labels.is_valid.mean() > 0.6
    assert 1.0 < np.nanstd(errors) < 4.0
    segments = read_fine_grained(recorded.layout.fine_grained("test", 30)).segments
    assert [s.start_frame for s in segments] == [round(s.start_s * 30) for s in session.take.segments]


def test_the_pictures_are_the_simulators(recorded: Recorded, session: Session) -> None:
    shot = session.shoot(1)
    for name in ("C10115_rgb", "HMC_84355350_mono10bit"):
        ((_, image),) = VideoReader(recorded.layout.video(NAME, name)).frames(1, 1)
        expected = shot.images[name] if shot.images[name].ndim == 3 else shot.images[name][..., None]
        difference = np.abs(image.astype(np.float64) - expected)
        assert difference.mean() < 4.0, "H.264 and sensor noise"
        assert np.abs(image.astype(np.float64).mean() - expected.mean()) < 2.0


def test_again_costs_nothing_and_workers_give_the_same(recorded: Recorded, tmp_path: Path) -> None:
    before = entries(recorded.workspace)
    again = pipeline("simulate", "executor=serial", *recorded.overrides, workspace=recorded.workspace).assert_done()
    assert new_stages(recorded.workspace, before) == {} and f"recorded: {NAME}" in again.said
    assert not (recorded.workspace / "runs" / "latest").exists()
    elsewhere = tmp_path / "work"
    pipeline("simulate", "executor=local", "executor.num_workers=2", *recorded.overrides, workspace=elsewhere)
    (one,) = {str(digests(folder, run.name)) for folder in (recorded.workspace, elsewhere)
              for run in (folder / "runs").iterdir()}  # fmt: skip
    assert "delivery" in one


def test_annotate_finds_the_joints_with_our_own_networks_and_each_round_is_evaluated(recorded: Recorded) -> None:
    outcome = pipeline("annotate", "executor=serial", *recorded.overrides, workspace=recorded.workspace).assert_done()
    assert "recorded first" not in outcome.said and f"{NAME}, round_3: 4 hands" in outcome.said
    joints = load(recorded.workspace / "runs" / "latest" / "round_3")
    assert set(joints["round"]) == {3}
    true = read_ground_truth(recorded.layout.ground_truth(NAME), TRUE_JOINTS).to_pandas()
    both = joints.merge(true, on=["sequence_id", "frame", "hand"], suffixes=("", "_true"))
    found, expected = (np.stack(both[c]).reshape(-1, 21, 3) for c in ("joints_world_mm", "joints_world_mm_true"))
    errors = np.linalg.norm(found - expected, axis=-1)
    assert len(both) == 2 * NUM_FRAMES and np.isfinite(errors).mean() > 0.9
    assert 0.5 < np.nanmedian(errors) < 12.0
    assert f"{NAME} against the simulator's truth" in outcome.said
    told = load(recorded.workspace / "runs" / "latest" / "evaluation_3")
    assert np.allclose(np.sort(np.stack(told.error_mm).ravel()), np.sort(errors.ravel()), atol=1e-3, equal_nan=True)
