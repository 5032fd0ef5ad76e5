"""An export is a release: our reader takes it, and crops show the same hands at the same joints."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from files_beside import files_beside
from headset import CHUNK, NUM_FRAMES, RECORDING, UNDISTORTED, annotation, hands_before, heads, ingested, write_headset

from assemblyhands_core.data import ego_boxes
from assemblyhands_core.data.assemblyhands import read_joint_annotations
from assemblyhands_core.data.catalog import SOURCES
from assemblyhands_core.data.coco_keypoints import read_coco_keypoints
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.rig import assembly_rig
from pipeline.exporting import export
from pipeline.graph import EGO_EDGE
from pipeline.manifests import ManifestRow
from pipeline.recordings import Recording, from_release
from stages._contract import Context
from stages.ingest_ego import STAGE as INGEST_EGO
from stages.ingest_ego import IngestEgoConfig
from stages.project_ego import STAGE as PROJECT_EGO
from stages.project_ego import ProjectEgoConfig
from stages.undistort import STAGE as UNDISTORT
from stages.write_ego_pictures import STAGE as WRITE_EGO_PICTURES
from stages.write_ego_pictures import WriteEgoPicturesConfig

ROW: ManifestRow = {"sequence_id": RECORDING, "split": "train", "folder": ".", "actions": ""}
CROPS = ProjectEgoConfig(
    gamma=1.75, size_px=256, jpeg_quality=95, min_joints=15, min_border_px=0.0, min_other_share=0.5
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, dict[str, pa.Table]]:
    """The folder of an export, the joints in it and what the stages read."""
    folder = tmp_path_factory.mktemp("export")
    rig = assembly_rig(20220302)
    joints = hands_before(next(iter(rig.ego_at(heads()[0]).values())))
    blobs = folder / "blobs"
    blobs.mkdir()
    tables = {**ingested(write_headset(folder, rig, joints), blobs), "joints": annotation(joints)}
    config = WriteEgoPicturesConfig(jpeg_quality=97, min_joints=15, min_border_px=0.0)
    pictures = WRITE_EGO_PICTURES.run(config, tables, Context(blobs, RECORDING))["pictures"]
    files = [str(blobs / name) for name in pictures["picture_file"].to_pylist()]
    place = pictures.schema.get_field_index("picture_file")
    pictures = pictures.set_column(place, "picture_file", pa.array(files))
    run = folder / "run"
    for node, name, table in (
        ("round_3", "joints", tables["joints"]),
        ("ingest", "views", tables["views"]),
        ("ego_pictures", "pictures", pictures),
    ):
        (run / node / name).mkdir(parents=True)
        (run / node / "manifest.json").write_text(json.dumps({"tables": [name]}))
        pq.write_table(files_beside(table, run / node / name), run / node / name / "all.parquet")
    (run / "run.json").write_text('{"command": "export"}')
    recording = Recording(RECORDING, None, {}, split="train")
    return export(run, [recording], 3), joints, tables


def test_the_joints_are_those_of_the_round_at_60_hz_keys(
    made: tuple[Path, np.ndarray, dict[str, pa.Table]],
) -> None:
    layout = DatasetLayout(made[0])
    found = read_joint_annotations(layout.annotations("train", "joint_3d"))[RECORDING]
    assert found.frames_60hz.tolist() == [0, 2, 4, 6]
    np.testing.assert_allclose(found.joints_world_mm, np.tile(made[1], (NUM_FRAMES, 1, 1, 1)), atol=1e-3)
    mask = pq.read_table(layout.annotations("train", "joint_3d").with_name(f"qa_{RECORDING}.parquet"))
    assert mask["frame_60hz"].to_pylist() == [0, 0, 2, 2, 4, 4, 6, 6] and "num_views" in mask.column_names
    assert json.loads((made[0] / "provenance.json").read_text()) == {"command": "export"}


def test_what_is_exported_is_read_again_and_shows_the_same(
    made: tuple[Path, np.ndarray, dict[str, pa.Table]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ego_boxes, "MIN_GIVEN_SIDE_PX", 1.0)  # these hands are smaller than the release's crops
    recording = from_release(ROW, DatasetLayout(made[0]))
    sources = recording.origin_rows(FileDigests(tmp_path / "digests.json"))[EGO_EDGE]
    context = Context(tmp_path, RECORDING)
    read = INGEST_EGO.run(
        IngestEgoConfig(chunk_frames=9, first_key=None), {"sources": SOURCES.from_rows(sources)}, context
    )
    rectified = UNDISTORT.run(UNDISTORTED, {"views": read["views"]}, context)["rectified_views"]
    again = PROJECT_EGO.run(CROPS, {**read, "rectified_views": rectified, "chunks": CHUNK}, context)[
        "crops"
    ].to_pylist()
    first = PROJECT_EGO.run(CROPS, made[2], context)["crops"].to_pylist()
    expected = {(r["frame"], r["hand"]): r for r in first if r["valid"]}
    found = {(r["frame"], r["hand"]): r for r in again if r["valid"]}
    assert set(found) == set(expected) and len(found) == 2 * (NUM_FRAMES - 1), "the third frame has no pose"
    for key, row in found.items():
        own = HANDS.index(key[1])
        camera_mm, expected_mm = (np.reshape(r["joints_camera_mm"], (2, 21, 3))[own] for r in (row, expected[key]))
        np.testing.assert_allclose(camera_mm, expected_mm, atol=1e-2)
        assert np.linalg.norm(np.subtract(row["intrinsics_px"][:2], expected[key]["intrinsics_px"][:2])) < 1e-2
        pictures = [decode_image(r["image"]).astype(float) for r in (row, expected[key])]
        assert pictures[0].shape == pictures[1].shape and np.abs(pictures[0] - pictures[1]).mean() < 3.0


def test_the_coco_file_has_the_same_pixels(made: tuple[Path, np.ndarray, dict[str, pa.Table]]) -> None:
    layout = DatasetLayout(made[0])
    pictures = read_coco_keypoints(layout.annotations("train", "ego_data").with_name("coco_hands_train.json"))
    assert len(pictures) == NUM_FRAMES - 1 and all((layout.images / p.file_name).is_file() for p in pictures)
    assert [hand.hand for hand in pictures[0].hands] == ["right", "left"]
    for hand in pictures[0].hands:
        left, top, right, bottom = hand.box_px
        points = hand.joints_px[hand.is_labelled]
        np.testing.assert_allclose([left, top], points.min(axis=0), atol=1e-3)
        np.testing.assert_allclose([right, bottom], points.max(axis=0), atol=1e-3)
