"""From a suspicious instant to a person's correction, and back, by the command line."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import Outcome, digests, entries, new_stages, pipeline
from tiny_recording import CHUNK_FRAMES, NUM_FRAMES, TinyRecording, write_recording

from assemblyhands_core.data.store import load
from assemblyhands_core.hands.joints import HANDS

FRAME, HAND, WRONG_VIEWS = 8, "left", ("front", "right", "top")  # in the second chunk
NUM_CHUNKS = NUM_FRAMES // CHUNK_FRAMES
CORRECTED_VIEWS = ("front", "right")


@dataclass(frozen=True)
class Corrected:
    """A recording with a bad instant in a workspace, and what was said and made on the way to its correction."""

    workspace: Path
    tiny: TinyRecording
    suspects: Outcome
    task: Path
    imported: Outcome
    plan: Outcome
    after: Outcome
    made: dict[str, int]

    @property
    def corrections(self) -> Path:
        return self.workspace / "corrections" / "tiny.csv"


def _write_bad_instant(tiny: TinyRecording) -> None:
    """Let the detector see the fingers of one hand at one instant somewhere else, in three of four views."""
    path = tiny.folder / "hands.parquet"
    rows = pq.read_table(path).to_pylist()
    for number, row in enumerate(rows):
        if row["frame"] == FRAME and row["hand"] == HAND and row["camera"] in WRONG_VIEWS:
            pixels = np.array(row["keypoints_px"])
            pixels[:40] += np.tile([35.0 * (-1) ** number, 28.0], 20)
            row["keypoints_px"] = pixels.tolist()
    pq.write_table(pa.Table.from_pylist(rows), path)


def _correct(tiny: TinyRecording, annotations: Path, path: Path) -> None:
    """Write what a tool would: pictures under other numbers and in a folder, joints moved to where they truly are."""
    document = json.loads(annotations.read_text())
    names = {image["id"]: image["file_name"] for image in document["images"]}
    categories = {category["id"]: category["name"] for category in document["categories"]}
    for annotation in document["annotations"]:
        _, camera, _, _ = names[annotation["image_id"]].split("--")
        hand = categories[annotation["category_id"]].removesuffix("_hand")
        if hand == HAND and camera in CORRECTED_VIEWS:
            true_px = tiny.cameras[camera].project(tiny.joints_mm[FRAME, HANDS.index(HAND)]) + 0.5
            annotation["keypoints"] = [round(v, 2) for x, y in true_px.tolist() for v in (x, y, 2)]
    for image in document["images"]:
        image["file_name"] = f"default/{image['file_name']}"
    path.write_text(json.dumps(document))


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> Corrected:
    folder = tmp_path_factory.mktemp("corrections")
    tiny, workspace = write_recording(folder / "tiny"), folder / "work"
    _write_bad_instant(tiny)
    annotate = ["executor=serial", *tiny.overrides()]
    pipeline("annotate", "run=before", *annotate, workspace=workspace).assert_done()
    suspects = pipeline("suspects", "seq=tiny", workspace=workspace).assert_done()
    (task,) = (workspace / "corrections" / "tiny").iterdir()
    _correct(tiny, task / "annotations" / "person_keypoints_default.json", folder / "back.json")
    imported = pipeline("correct", f"corrected={folder / 'back.json'}", workspace=workspace).assert_done()
    plan = pipeline("plan", *tiny.overrides(), workspace=workspace).assert_done()
    before = entries(workspace)
    after = pipeline("annotate", "run=after", *annotate, workspace=workspace).assert_done()
    return Corrected(workspace, tiny, suspects, task, imported, plan, after, new_stages(workspace, before))


def test_the_bad_instant_is_suspicious_and_its_pictures_are_those_of_the_videos(corrected: Corrected) -> None:
    with (corrected.task / "suspects.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["frame"], row["hand"]) for row in rows] == [(str(FRAME), HAND)]
    assert "1 of 48 hands are suspicious" in corrected.suspects.out
    with (corrected.task / "pictures.csv").open() as file:
        pictures = list(csv.DictReader(file))
    assert {row["camera_id"] for row in pictures} == set(corrected.tiny.cameras)
    assert {row["file_name"] for row in pictures} == {path.name for path in (corrected.task / "images").iterdir()}
    labels = json.loads((corrected.task / "cvat_labels.json").read_text())
    assert [label["name"] for label in labels] == ["right_hand", "left_hand"]


def test_only_what_was_moved_is_a_correction(corrected: Corrected) -> None:
    assert "of 1 hands; runs of it use them from now on" in corrected.imported.out
    with corrected.corrections.open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["frame"], row["hand"], row["visibility"]) for row in rows} == {(str(FRAME), HAND, "2")}
    assert {row["camera_id"] for row in rows} == set(CORRECTED_VIEWS)


def test_the_joints_are_right_then_and_marked(corrected: Corrected) -> None:
    error_mm, sources = {}, {}
    for run in ("before", "after"):
        table = load(corrected.workspace / "runs" / run / "round_0")
        found_mm = np.stack(table.joints_world_mm.tolist()).reshape(NUM_FRAMES, 2, 21, 3).astype(np.float64)
        error_mm[run] = np.linalg.norm(found_mm - corrected.tiny.joints_mm, axis=-1)
        sources[run] = table.source.to_numpy().reshape(NUM_FRAMES, 2)
    bad = FRAME, HANDS.index(HAND)
    fingers = error_mm["before"][bad][:20]
    assert (~(fingers < 20)).sum() > 10, "the fingers were missing or far off"
    assert error_mm["after"][bad].max() < 1.5
    others = np.ones((NUM_FRAMES, 2), dtype=bool)
    others[bad] = False
    assert np.array_equal(error_mm["before"][others], error_mm["after"][others])
    assert sources["after"][bad] == "manual"
    assert set(sources["after"][others]) == set(sources["before"].ravel()) == {"2d_triangulation"}
    points = load(corrected.workspace / "runs" / "after" / "corrections")
    assert f"tiny: {len(points)} points of 1 hands were corrected by hand" in corrected.after.out
    assert set(points.camera_id) == set(CORRECTED_VIEWS) and set(points.frame) == {FRAME}


def test_one_chunk_runs_again_and_the_plan_says_so(corrected: Corrected) -> None:
    lines = {cells[1]: cells for line in corrected.plan.out.splitlines() if len(cells := _cells(line)) > 4}
    assert lines["corrections"][2:4] == ["0", str(NUM_CHUNKS)]
    assert lines["detect_keypoints"][2:4] == [str(NUM_CHUNKS), "0"]
    assert lines["round_0"][2:5] == [str(NUM_CHUNKS - 1), "1", "input corrections is new"]
    assert lines["quality"][2:5] == ["0", "1", "round_0 runs first"]
    assert corrected.made["triangulate"] == 1, "the chunk with the bad instant"
    assert set(corrected.made) <= {"read_corrections", "triangulate", "measure_quality", "draw_overlays"}


def test_without_the_file_all_is_as_before_at_no_cost(corrected: Corrected) -> None:
    away = corrected.corrections.with_suffix(".away")
    corrected.corrections.rename(away)
    try:
        before = entries(corrected.workspace)
        pipeline("annotate", "run=gone", *corrected.tiny.overrides(), workspace=corrected.workspace).assert_done()
        assert new_stages(corrected.workspace, before) == {}
        assert digests(corrected.workspace, "gone") == digests(corrected.workspace, "before")
    finally:
        away.rename(corrected.corrections)
    plan = pipeline("plan", *corrected.tiny.overrides(), workspace=corrected.workspace).assert_done()
    assert "nothing to do" in plan.out, "corrections survive runs"


def test_views_whose_videos_were_moved_are_left_out_and_named(corrected: Corrected) -> None:
    front = corrected.tiny.video("front")
    tasks = corrected.workspace.parent / "tasks"
    suspects = ["suspects", "run=before", "seq=tiny", f"corrections={tasks}"]
    view = ["view", "run=before", "seq=tiny", "view.num_frames=2", "view.max_side_px=160"]
    front.rename(front.with_suffix(".away"))
    try:
        some = pipeline(*suspects, workspace=corrected.workspace).assert_done()
        seen = pipeline(*view, workspace=corrected.workspace)
        blind = pipeline(*view, "view.pictures=false", workspace=corrected.workspace).assert_done()
    finally:
        front.with_suffix(".away").rename(front)
    assert f"front is left out: {front}: no such file" in some.said and "in 3 pictures" in some.said
    (listed,) = tasks.glob("tiny/*/pictures.csv")
    with listed.open() as file:
        assert {row["camera_id"] for row in csv.DictReader(file)} == set(corrected.tiny.cameras) - {"front"}
    assert seen.code == 2 and "Traceback" not in seen.said
    assert seen.err.startswith(f"error: tiny: {front}: ") and "view.pictures=false" in seen.err
    assert "tiny.rrd" in blind.out


def test_without_any_video_there_is_no_task_but_a_sentence(corrected: Corrected) -> None:
    videos = [corrected.tiny.video(camera_id) for camera_id in corrected.tiny.cameras]
    tasks = corrected.workspace.parent / "none"
    for video in videos:
        video.rename(video.with_suffix(".away"))
    try:
        blind = pipeline("suspects", "run=before", "seq=tiny", f"corrections={tasks}", workspace=corrected.workspace)
    finally:
        for video in videos:
            video.with_suffix(".away").rename(video)
    assert blind.code == 2 and "Traceback" not in blind.said and not tasks.exists()
    assert "error: tiny: no video of the views to look at can be read; put them back" in blind.err


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("│")[1:-1]]
