"""The AssemblyHands release in miniature, by the command line: what is there, train, predict, and the same figure."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, pipeline
from mini_release import CAMERAS, FIRST_KEY, NUM_FRAMES, SPLITS, TEST, TRAIN, true_joints, write_release

from assemblyhands_core.data.hands2023 import SUBMISSION_NAME
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.store import load
from assemblyhands_core.hands.joints import HANDS

TINY = (
    "train_svegonet.backbone=mobilenetv3_small_050", "train_svegonet.num_levels=2", "train_svegonet.num_channels=8",
    "train_svegonet.image_size_px=64", "train_svegonet.num_depths=8", "train_svegonet.from_imagenet=false",
    "train_svegonet.backbone_from=null",
    "train_svegonet.num_epochs=1", "train_svegonet.steps_per_epoch=2", "train_svegonet.batch_size=4",
    "train_svegonet.num_loaders=0", "tabulate_ego.num_resamples=100", "predict_ego.min_confidence=0.0",
)  # fmt: skip


@dataclass(frozen=True)
class Release:
    """A release on disk, and the manifest of its recordings."""

    layout: DatasetLayout
    manifest: Path

    def run(self, *arguments: str, workspace: Path) -> Outcome:
        where = (f"manifest={self.manifest}", "seq=all", f"release={self.layout.root}", "executor=serial")
        return pipeline(*arguments, *where, workspace=workspace)


def _release(folder: Path, splits: Mapping[str, str] = SPLITS) -> Release:
    rows = [f"{name},{split},,,assemblyhands" for name, split in splits.items()]
    manifest = folder / "set.csv"
    manifest.write_text("\n".join(["sequence_id,split,calibration,videos,package", *rows]) + "\n")
    return Release(write_release(folder / "release"), manifest)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The workspace after a training of one epoch."""
    folder = tmp_path_factory.mktemp("release")
    outcome = _release(folder).run("target=ego_evaluation_manual", *TINY, workspace=folder / "work")
    outcome.assert_done()
    return folder / "work"


def test_every_picture_becomes_a_crop_of_each_boxed_hand_or_has_its_reason(trained: Path) -> None:
    crops = load(trained / "runs" / "latest" / "project_manual")
    assert set(crops.sequence_id) == {TRAIN, TEST} and set(crops.camera_id) == set(CAMERAS)
    assert sorted(set(crops.frame)) == list(range(NUM_FRAMES)), "the first key is frame 0"
    lost = crops[(crops.frame == 2) & (crops.camera_id == CAMERAS[1])]
    assert set(lost.reason) == {"no_pose"} and len(lost) == 4
    assert set(crops[~crops.valid].reason) <= {"no_pose", "no_box"} and crops.valid.sum() >= 20
    row = crops[crops.valid & (crops.sequence_id == TRAIN) & (crops.camera_id == CAMERAS[1])].iloc[0]
    own = HANDS.index(row.hand)
    expected = true_joints(TRAIN)[row.frame, own] - [30.0, 0.0, 0.0]
    np.testing.assert_allclose(np.reshape(row.joints_camera_mm, (2, 21, 3))[own], expected, atol=1e-3)


def test_the_toolkits_figure_is_that_of_its_definition(trained: Path) -> None:
    """Per hand minus its wrist, the mean of each of the 42 joints' mean errors (formats 2.8), from the tables alone."""
    latest = trained / "runs" / "latest"
    crops, hands = load(latest / "project_manual"), load(latest / "predict_manual_manual")
    key = ["sequence_id", "frame", "hand", "camera_id"]
    rows = crops[crops.valid].merge(hands[[*key, "joints_camera_mm"]], on=key, suffixes=("", "_found"))
    errors: list[list[float]] = [[] for _ in range(42)]
    for row in rows.to_dict("records"):
        own = HANDS.index(row["hand"])
        true = np.reshape(row["joints_camera_mm"], (2, 21, 3))[own]
        found = np.reshape(row["joints_camera_mm_found"], (21, 3))
        error = np.linalg.norm((found - found[20]) - (true - true[20]), axis=1)
        for joint in np.flatnonzero(np.reshape(row["is_labelled"], (2, 21))[own]):
            errors[21 * own + joint].append(float(error[joint]))
    expected = np.mean([np.mean(joint) for joint in errors if joint])
    metrics = load(latest / "ego_evaluation_manual")
    line = metrics[(metrics.metric == "toolkit_mpjpe_mm") & (metrics.row == "manual")].iloc[0]
    assert line.value == pytest.approx(expected, rel=1e-4) and 1.0 < expected < 500.0
    assert line.n == sum(map(len, errors)) and line.coverage == 100.0


def test_predictions_fill_the_challenges_template(trained: Path, tmp_path: Path) -> None:
    """Pictures with boxes and without labels, as in the test split: weights are those of the training."""
    weights = load(trained / "runs" / "latest" / "svegonet_manual").weights_file[0]
    release = _release(tmp_path, {TEST: "val"})
    release.layout.annotations("val", "joint_3d").unlink()
    frames = {f"{FIRST_KEY + 2 * frame:06d}": {"world_coord": [[-1.0] * 3] * 42} for frame in range(NUM_FRAMES)}
    template = tmp_path / "template.json"
    template.write_text(json.dumps({"annotations": {TEST: {**frames, "000998": {"world_coord": []}}}}))
    settings = (f"hands2023_template={template}", f"use_svegonet.weights={weights}", *TINY[-2:])
    outcome = release.run("predict", *settings, workspace=tmp_path / "work").assert_done()
    assert load(tmp_path / "work" / "runs" / "latest" / "ego_evaluation").empty, "without labels there are no figures"
    assert f"{TEST}: 1 of {NUM_FRAMES + 1} frames are not predicted, 000998 the first" in outcome.said
    with zipfile.ZipFile(tmp_path / "work" / "runs" / "latest" / "submission" / f"{SUBMISSION_NAME[:-5]}.zip") as file:
        filled = json.loads(file.read(SUBMISSION_NAME))["annotations"][TEST]
    assert set(filled) == {*frames, "000998"} and filled["000998"]["world_coord"] == [[0.0] * 3] * 42
    found = np.array([filled[key]["world_coord"] for key in frames])
    assert found.shape == (NUM_FRAMES, 42, 3) and (np.abs(found).sum(axis=(1, 2)) > 0).all()


def test_preflight_says_what_is_there(tmp_path: Path) -> None:
    release = _release(tmp_path)
    listed = 2 * NUM_FRAMES
    found = release.run("preflight", workspace=tmp_path / "work")
    found.assert_refused(1, f"{listed} of {listed}", "calib.txt: is not there")
    gone = next(release.layout.images.rglob(f"{FIRST_KEY:06d}.jpg"))
    gone.unlink()
    release.layout.annotations("val", "ego_calib").write_text('{"calibration": {"x": 3}}')
    again = release.run("preflight", workspace=tmp_path / "work")
    again.assert_refused(
        1, f"{listed - 1} of {listed}", f"{gone}: is not there", "assemblyhands_val_ego_calib_v1-1.json: x"
    )
    pipeline("preflight", f"manifest={release.manifest}", "seq=all", workspace=tmp_path / "work").assert_refused(
        2, "say where the AssemblyHands release lies"
    )


def test_pictures_that_come_later_are_cropped_then(tmp_path: Path) -> None:
    release = _release(tmp_path, {TRAIN: "train"})
    file = sorted(release.layout.images.rglob(f"{TRAIN}/{CAMERAS[0]}/*.jpg"))[0]
    content = file.read_bytes()
    file.unlink()
    release.run("target=project_manual", workspace=tmp_path / "work").assert_done()
    node = tmp_path / "work" / "runs" / "latest" / "project_manual"
    assert "missing_image" in set(load(node).reason)
    file.write_bytes(content)
    release.run("target=project_manual", workspace=tmp_path / "work").assert_done()
    assert "missing_image" not in set(load(node).reason)


def test_boxes_of_no_size_and_hands_with_few_joints_harm_nobody_else(tmp_path: Path) -> None:
    release = _release(tmp_path, {TRAIN: "train"})
    path = release.layout.annotations("train", "ego_data")
    document = json.loads(path.read_text())
    first, second = (block for block in document["annotations"][:2])
    hand = next(name for name, box in first["bbox"].items() if box)
    first["bbox"][hand] = first["bbox"][hand][:2] * 2
    second["joint_valid"] = [1] * 9 + [0] * 33
    path.write_text(json.dumps(document))
    release.run("target=project_manual", workspace=tmp_path / "work").assert_done()
    crops = load(tmp_path / "work" / "runs" / "latest" / "project_manual")
    row = crops[(crops.frame == 0) & (crops.camera_id == CAMERAS[0]) & (crops.hand == hand)].iloc[0]
    assert row.valid and row.width_px == 100, "the toolkit's smallest crop"
    few = crops[(crops.frame == 0) & (crops.camera_id == CAMERAS[1]) & (crops.hand == "right")].iloc[0]
    assert few.reason == "too_few_joints"


def test_lost_and_broken_pictures_are_counted_by_reason(tmp_path: Path) -> None:
    release = _release(tmp_path, {TRAIN: "train"})
    files = sorted((release.layout.images).rglob(f"{TRAIN}/{CAMERAS[0]}/*.jpg"))
    files[0].unlink()
    files[1].write_bytes(b"no picture")
    release.run("target=project_manual", workspace=tmp_path / "work").assert_done()
    crops = load(tmp_path / "work" / "runs" / "latest" / "project_manual")
    first = crops[crops.camera_id == CAMERAS[0]]
    assert set(first[first.frame == 0].reason) <= {"missing_image", "no_box"}
    assert "missing_image" in set(first[first.frame == 0].reason)
    assert "unreadable_image" in set(first[first.frame == 1].reason)
    assert first[first.frame > 1].valid.any()


@pytest.mark.parametrize(
    ("kind", "old", "new", "said"),
    [
        ("joint_3d", '"joint_valid"', '"joint_val"', f"{NUM_FRAMES} entries in all are wrong"),
        ("ego_calib", "160.0", "NaN", "NaN"),
        ("ego_data", '"bbox"', '"box"', "bbox"),
    ],
)
def test_a_malformed_file_is_named_with_the_reason(tmp_path: Path, kind: str, old: str, new: str, said: str) -> None:
    release = _release(tmp_path, {TRAIN: "train"})
    path = release.layout.annotations("train", kind)  # type: ignore[arg-type]
    path.write_text(path.read_text().replace(old, new, -1 if kind == "joint_3d" else 1))
    outcome = release.run("target=ingest_ego", workspace=tmp_path / "work")
    outcome.assert_refused(1, path.name, said)
