"""A delivered recording is whole or has no list, and an earlier order leaves nothing behind."""

from pathlib import Path

import numpy as np
import pytest

from assemblyhands_core.data.assemblyhands import JointAnnotations, write_joint_annotations
from assemblyhands_core.data.fine_grained import Action, Segment, write_fine_grained_30fps
from assemblyhands_core.data.layout import DatasetLayout, read_split
from assemblyhands_core.data.split_files import ACTIONS_SHARE, JOINTS_SHARE
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.studio_tables import DELIVERED
from pipeline.config import GcConfig, RigConfig, RunConfig
from pipeline.dag import build_dag
from pipeline.executor_config import LocalConfig
from pipeline.publishing import publish
from pipeline.takes import absent_takes
from pipeline.tasks import Result, Shard
from stages.deliver_recording import DeliverRecordingConfig

NAME = "nusar-2021_action_both_1002-c13e_1002_user_id_2022-03-03_140549"


def config(folder: Path, rig: str = "assembly", split: str = "test") -> RunConfig:
    header = "sequence_id,split,calibration,videos,package,rig,duration_s"
    (folder / "set.csv").write_text(f"{header}\n{NAME},{split},,,synthetic,{rig},2.5\n")
    found = RunConfig(
        seq="all", target="simulate", manifest=str(folder / "set.csv"), release=None, workspace=folder / "work", run="",
        rounds=3, rig=RigConfig(calibration=None, videos=None), gc=GcConfig(keep_runs=1, dry_run=False),
        executor=LocalConfig(name="serial", num_workers=1, memory_limit="auto"),
    )  # fmt: skip
    found._dag, found._stages = build_dag(), {"deliver_recording": DeliverRecordingConfig(labelled_every_s=1.0)}
    return found


def delivery(folder: Path, order: RunConfig, *videos: str) -> Result:
    """Put an entry into the store as the stage does."""
    store, layout = Store(order.workspace), DatasetLayout(Path())
    with store.draft("deliver_recording", {"videos": list(videos)}) as draft:
        joints = JointAnnotations(np.array([0]), np.zeros((1, 2, 21, 3)), np.ones((1, 2, 21), dtype=bool))
        write_joint_annotations(draft.folder / "joints", {NAME: joints})
        segment = Segment(NAME, 0, 9, 30, Action.of("screw", "screw", ("screw",)), "c13e", "car", views=videos)
        write_fine_grained_30fps(draft.folder / "actions", [segment])
        paths = {
            layout.labels(NAME) / JOINTS_SHARE: "joints",
            layout.labels(NAME) / ACTIONS_SHARE: "actions",
            **{layout.video(NAME, video): video for video in videos},
        }
        for video in videos:
            (draft.folder / video).write_text(video)
        rows = [{"sequence_id": NAME, "path": str(p), "content_file": n, "sha256": n} for p, n in paths.items()]
        record = draft.write({"delivered": (DELIVERED, DELIVERED.from_rows(rows))}, 1.0)
    return Result("delivery", Shard(NAME), "done", record.key, record.outputs)


def test_a_recording_is_laid_out_and_then_counts_as_delivered(tmp_path: Path) -> None:
    order, root = config(tmp_path), tmp_path / "work" / "synthetic"
    result = delivery(tmp_path, order, "C10095_rgb", "C10115_rgb")
    assert absent_takes(order) == [NAME]
    assert publish(order, [result], root) == [NAME] and absent_takes(order) == []
    layout = DatasetLayout(root)
    video = layout.video(NAME, "C10095_rgb")
    assert video.read_text() == "C10095_rgb" and video.stat().st_nlink == 2 and not video.stat().st_mode & 0o222
    assert read_split(layout.split("test")) == [NAME]
    assert publish(order, [result], root) == [NAME], "again is no harm"


def test_another_order_leaves_nothing_of_the_first_behind(tmp_path: Path) -> None:
    root = tmp_path / "work" / "synthetic"
    layout = DatasetLayout(root)
    order = config(tmp_path)
    publish(order, [delivery(tmp_path, order, "C10095_rgb", "C10115_rgb")], root)
    desktop = config(tmp_path, "desktop", "desktop")
    assert absent_takes(desktop) == [NAME]
    publish(desktop, [delivery(tmp_path, desktop, "D01_rgb")], root)
    assert [path.name for path in (root / "recordings" / NAME).iterdir()] == ["D01_rgb.mp4"]
    assert read_split(layout.split("test")) == [] and read_split(layout.split("desktop")) == [NAME]


def test_a_recording_whose_publication_broke_off_is_not_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order, root = config(tmp_path), tmp_path / "work" / "synthetic"
    result = delivery(tmp_path, order, "C10095_rgb")
    publish(order, [result], root)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr("pipeline.publishing.write_shared_files", full)
        with pytest.raises(OSError, match="No space left"):
            publish(order, [result], root)
    assert absent_takes(order) == [NAME]
    publish(order, [result], root)
    assert absent_takes(order) == []


def test_where_links_cannot_be_made_files_are_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr("os.link", refused)
    order, root = config(tmp_path), tmp_path / "work" / "synthetic"
    publish(order, [delivery(tmp_path, order, "C10095_rgb")], root)
    video = DatasetLayout(root).video(NAME, "C10095_rgb")
    assert video.read_text() == "C10095_rgb" and video.stat().st_nlink == 1
    assert not list(video.parent.glob(".*")), "no draft is left"
