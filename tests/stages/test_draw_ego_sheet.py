"""The sheet of egocentric predictions: a row a crop, label and prediction where they are, the world from the side."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest
from ego_crops import CAMERA, ego_crops, hands

from assemblyhands_core.data.camera_rows import camera_to_row
from assemblyhands_core.data.catalog import VIEWS
from assemblyhands_core.data.ego_tables import EGO_CROPS, EGO_HANDS
from assemblyhands_core.data.video import VideoWriter
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import Pinhole
from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.viz.overlays import contact_sheet
from stages._contract import Context
from stages.draw_ego_sheet import STAGE, DrawEgoSheetConfig

CONFIG = DrawEgoSheetConfig(num_crops=2, tile_px=128, gamma=2.0)


def _side() -> Camera:
    """A camera a metre to the right of the hands, looking across."""
    T = np.eye(4)
    T[:3, :3] = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
    T[:3, 3] = [-350.0, 0.0, 1000.0]
    return Camera("side", 320, 240, 300.0, 300.0, 159.5, 119.5, Pinhole(), T)


@pytest.fixture
def views(tmp_path: Path) -> pa.Table:
    """The side view, dark, and one that cannot be used."""
    path = tmp_path / "side.mp4"
    with VideoWriter(path, 320, 240, Fraction(30), crf=10) as video:
        for _ in range(6):
            video.write(np.full((240, 320, 3), 30, np.uint8))
    row = {
        "sequence_id": "s",
        "camera_id": "side",
        "video_file": str(path),
        "video_sha256": "",
        "num_frames": 6,
        "rate_hz": 30.0,
        "image_fit": "same",
        "note": "",
        "valid": True,
        "reason": "",
    }
    return VIEWS.from_rows(
        [row | camera_to_row(_side()), row | camera_to_row(_side()) | {"camera_id": "x", "valid": False}]
    )


def _predicted(crops: pa.Table, shift_px: float = 0.0) -> pa.Table:
    rows: list[dict[str, Any]] = []
    for crop in crops.filter(crops["valid"]).to_pylist():
        joints = hands(crop["frame"])[HANDS.index(crop["hand"])]
        rows.append(
            {
                **{name: crop[name] for name in EGO_CROPS.key},
                "joints_px": (CAMERA.project(joints) + shift_px).ravel(),
                "depth_mm": np.zeros(21),
                "confidence": np.ones(21),
                "joints_camera_mm": joints.ravel(),
                "joints_world_mm": joints.ravel(),
                "wrist_depth_mm": 350.0,
                "wrist_depth_source": "label",
                "identity": crop["hand"],
                "identity_probability": [1.0, 0.0, 0.0],
                "valid": True,
                "reason": "",
            }
        )
    return EGO_HANDS.from_rows(rows)


def _sheet(views: pa.Table, hands_table: pa.Table, folder: Path) -> np.ndarray:
    inputs = {"views": views, "crops": ego_crops(6), "hands": hands_table}
    (row,) = STAGE.run(CONFIG, inputs, Context(folder, "s"))["overlays"].to_pylist()
    assert (row["kind"], row["camera_id"]) == ("ego", "all")
    return np.asarray(cv2.imread(str(folder / row["overlay_file"])))


def test_label_and_prediction_stand_side_by_side_and_the_side_view_shows_the_hand(
    views: pa.Table, tmp_path: Path
) -> None:
    same = _sheet(views, _predicted(ego_crops(6)), tmp_path)
    height, width = same.shape[0] // CONFIG.num_crops, same.shape[1] // 3
    tiles = [[same[r * height : (r + 1) * height, c * width : (c + 1) * width] for c in range(3)] for r in range(2)]
    for label, predicted, side in tiles:
        body = slice(height - CONFIG.tile_px, height)
        assert np.array_equal(label[body], predicted[body]), "what agrees looks the same"
        assert (side[body].astype(int).max(axis=2) > 120).sum() > 50, "bones are drawn over the dark picture"
    moved = _sheet(views, _predicted(ego_crops(6), shift_px=6.0), tmp_path)
    first = moved[height - CONFIG.tile_px : height]
    assert not np.array_equal(first[:, :width], first[:, width : 2 * width])


def test_captions_of_a_real_headset_fit_their_tiles(
    views: pa.Table, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captions: list[str] = []

    def remember(tiles: list[np.ndarray], columns: int, texts: list[str]) -> np.ndarray:
        captions.extend(texts)
        return contact_sheet(tiles, columns, texts)

    monkeypatch.setattr("stages.draw_ego_sheet.contact_sheet", remember)
    config = CONFIG.model_copy(update={"tile_px": 320})
    crops, found = (
        spec.from_rows([{**row, "camera_id": "HMC_21179183_mono10bit"} for row in table.to_pylist()])
        for spec, table in ((EGO_CROPS, ego_crops(6)), (EGO_HANDS, _predicted(ego_crops(6))))
    )
    STAGE.run(config, {"views": views, "crops": crops, "hands": found}, Context(tmp_path, "s"))
    first = ["label, right hand", "predicted, right hand", "predicted, seen from"]
    assert sorted(caption.split("\n")[0] for caption in captions[:3]) == sorted(first)
    assert captions[2].split("\n")[1] == "side"
    blank = np.zeros((320, 320, 3), np.uint8)
    for line in (f"{line}5" for caption in captions for line in caption.split("\n")):  # a frame of one digit more
        whole, shorter = (contact_sheet([blank], 1, [text]) for text in (line, line[:-1]))
        assert not np.array_equal(whole, shorter), f"{line} is cut off"


def test_without_predictions_there_is_no_sheet(views: pa.Table, tmp_path: Path) -> None:
    inputs = {"views": views, "crops": ego_crops(6), "hands": EGO_HANDS.empty()}
    assert STAGE.run(CONFIG, inputs, Context(tmp_path, "s"))["overlays"].num_rows == 0
