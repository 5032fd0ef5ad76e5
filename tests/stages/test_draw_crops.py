"""What the studio draws for training: crops and pictures whose labels lie where the pictures show things."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import CHUNKS
from assemblyhands_core.data.crop_images import decode_image
from assemblyhands_core.data.hand_crops import hand_labels, stored_hands
from assemblyhands_core.data.studio_tables import CROP_ORDERS
from stages import draw_body_views, draw_crops, plan_crops
from stages._contract import Context, Stage

CONF = Path(__file__).parents[2] / "conf" / "stage"
ORDER = CROP_ORDERS.from_rows(
    [{"sequence_id": "set", "split": "train", "rig": "assembly", "duration_s": 60.0, "package": "crops"}]
)


def _config(stage: Stage[Any], **changes: Any) -> Any:
    return stage.config.model_validate({**yaml.safe_load((CONF / f"{stage.name}.yaml").read_text()), **changes})


def _chunk(number: int, num_frames: int = 2) -> pa.Table:
    row = {"sequence_id": "set", "chunk": number, "first_frame": 24 * number, "num_frames": num_frames}
    return CHUNKS.from_rows([row])


def _run(stage: Stage[Any], config: Any, chunk: pa.Table) -> Mapping[str, pa.Table]:
    return stage.run(config, {"orders": ORDER, "chunks": chunk}, Context(Path(), "set"))


def test_an_order_is_cut_into_takes_of_24_seconds() -> None:
    config = _config(plan_crops.STAGE, instants_per_take=10)
    chunks = plan_crops.STAGE.run(config, {"orders": ORDER}, Context(Path(), "set"))["chunks"].to_pylist()
    assert [(c["chunk"], c["first_frame"], c["num_frames"]) for c in chunks] == [(0, 0, 10), (1, 10, 10)]


@pytest.fixture(scope="module")
def crops() -> Mapping[str, pa.Table]:
    config = _config(draw_crops.STAGE, size_px=64, num_views=3)
    return _run(draw_crops.STAGE, config, _chunk(3))


def test_every_hand_has_a_row_in_every_view_and_a_label(crops: Mapping[str, pa.Table]) -> None:
    assert crops["labels"].num_rows == 2 * 2 and crops["crops"].num_rows == 2 * 2 * 3
    assert set(crops["labels"]["frame"].to_pylist()) == {72, 73} and set(crops["labels"]["source"].to_pylist()) == {
        "truth"
    }
    assert len(set(crops["crops"]["camera_id"].to_pylist())) == 3
    assert to_numpy(crops["labels"]["valid"]).all()


def test_boxes_are_around_the_true_hands_as_wide_as_told(crops: Mapping[str, pa.Table]) -> None:
    hands, labels = stored_hands(crops["crops"]), hand_labels(crops["labels"])
    widths, shifts = [], []
    for key, hand in hands.items():
        for view in hand.views:
            assert decode_image(view.image).shape == (64, 64, 3) and view.size_px == (64, 64)
            pixels = view.project(labels[key].joints_world_mm)
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            widths.append(64 / (high - low).max())
            shifts.append(np.abs((low + high) / 2 - 31.5).max() / 64)
    assert (
        len(widths) >= 8
        and 2.7 < min(widths) <= max(widths) < 3.8
        and np.median(widths) == pytest.approx(3.2, rel=0.06)
    )
    assert 0.002 < np.median(shifts) < 0.05 and max(shifts) < 0.1


def test_equal_orders_give_equal_crops_and_other_takes_others(crops: Mapping[str, pa.Table]) -> None:
    config = _config(draw_crops.STAGE, size_px=64, num_views=3)
    assert _run(draw_crops.STAGE, config, _chunk(3))["crops"].equals(crops["crops"])
    other = _run(draw_crops.STAGE, config, _chunk(4))["labels"]
    assert not np.allclose(to_numpy(other["joints_world_mm"]), to_numpy(crops["labels"]["joints_world_mm"]))


def test_bodies_are_drawn_of_some_takes_with_keypoints_where_they_are_in_the_picture() -> None:
    config = _config(draw_body_views.STAGE, width_px=160, num_instants=2, num_views=2, every_nth_take=2)
    labels = _run(draw_body_views.STAGE, config, _chunk(4))["labels"]
    assert labels.num_rows == 2 * 2 and set(labels["frame"].to_pylist()) == {96, 97}
    valid, pixels = to_numpy(labels["valid"]), to_numpy(labels["body_px"]).reshape(-1, 17, 2)
    assert 0.4 < valid.mean() <= 1.0 and np.array_equal(np.isfinite(pixels).all(axis=-1), valid)
    assert ((pixels[valid] > -0.5) & (pixels[valid] < [159.5, 89.5])).all()
    assert {decode_image(row).shape for row in labels["image"].to_pylist()} == {(90, 160, 3)}
    assert _run(draw_body_views.STAGE, config, _chunk(3))["labels"].num_rows == 0, "not every take"


def test_more_instants_than_a_take_has_are_refused() -> None:
    config = _config(draw_body_views.STAGE, num_instants=3, every_nth_take=1)
    with pytest.raises(ValueError, match="num_instants=3 is more than the 2 of a take"):
        _run(draw_body_views.STAGE, config, _chunk(4))
