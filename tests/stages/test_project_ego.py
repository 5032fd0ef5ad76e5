"""From a headset's files to crops: a fisheye video from a moving head, where every bright spot's place is known."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from headset import NUM_FRAMES, RECORDING, annotation, hands_before, heads, ingested, write_headset

from assemblyhands_core.data.camera_rows import camera_from_row
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.hands.joints import HANDS, WRIST
from assemblyhands_core.synthetic.rig import Rig, assembly_rig
from stages._contract import Context
from stages.ingest_ego import STAGE as INGEST_EGO
from stages.ingest_ego import IngestEgoConfig
from stages.project_ego import STAGE, ProjectEgoConfig

CONFIG = ProjectEgoConfig(
    gamma=1.75, size_px=256, jpeg_quality=95, min_joints=15, min_border_px=0.0, min_other_share=0.5
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return assembly_rig(20220302)


@pytest.fixture(scope="module")
def joints(rig: Rig) -> np.ndarray:
    """Joints (2, 21, 3), the same at all frames, seen by the headset's first camera."""
    return hands_before(next(iter(rig.ego_at(heads()[0]).values())))


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory, rig: Rig, joints: np.ndarray) -> pa.Table:
    return write_headset(tmp_path_factory.mktemp("headset"), rig, joints)


@pytest.fixture(scope="module")
def headset(sources: pa.Table, tmp_path_factory: pytest.TempPathFactory) -> dict[str, pa.Table]:
    return ingested(sources, tmp_path_factory.mktemp("blobs"))


def _run(
    headset: dict[str, pa.Table], joints: pa.Table, config: ProjectEgoConfig = CONFIG
) -> dict[tuple[int, str], dict[str, Any]]:
    inputs = {**headset, "joints": joints}
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
    expected = next(iter(rig.ego_at(heads()[3]).values())).T_camera_from_world
    np.testing.assert_allclose(np.reshape(frames[3]["T_camera_from_world"], (4, 4)), expected, rtol=0, atol=1e-12)


def test_a_crop_shows_the_hand_where_its_labels_say(headset: dict[str, pa.Table], joints: np.ndarray) -> None:
    rows = _run(headset, annotation(joints))
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
    rows = _run(headset, annotation(unknown, range(1)))
    assert rows[0, "right"]["valid"] and rows[0, "left"]["reason"] == "unknown_hand"
    behind = joints.copy()
    camera = next(iter(headset["frames"].to_pylist()))
    pose = np.reshape(camera["T_camera_from_world"], (4, 4))
    behind[0] += np.linalg.inv(pose)[:3, :3] @ [0.0, 0.0, -600.0]
    assert _run(headset, annotation(behind, range(1)))[0, "right"]["reason"] == "behind_camera"
    assert not _run(headset, annotation(joints, range(9, 11))), "another chunk's frames"
    beyond = _run(headset, annotation(joints, range(NUM_FRAMES, NUM_FRAMES + 1)))
    assert {row["reason"] for row in beyond.values()} == {"no_pose"}
    strict = _run(headset, annotation(joints, range(1)), CONFIG.model_copy(update={"min_border_px": 400.0}))
    assert {row["reason"] for row in strict.values()} == {"near_border"}


def test_hands_that_meet_are_in_one_crop(headset: dict[str, pa.Table], joints: np.ndarray) -> None:
    together = np.stack([joints[0], joints[0] + 5.0])
    rows = _run(headset, annotation(together, range(1)))
    assert {row["identity"] for row in rows.values()} == {"both"}
    assert all(np.all(row["is_labelled"]) for row in rows.values())


def test_a_sequence_that_its_headsets_file_lacks_is_named(sources: pa.Table, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"ego\.json has no recording other"):
        INGEST_EGO.run(
            IngestEgoConfig(chunk_frames=3, first_key=None), {"sources": sources}, Context(tmp_path, "other")
        )
