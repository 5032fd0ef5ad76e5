"""SVEgoNet learns from the training sequences of a run alone, by the labels that it is told to."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import yaml
from ego_crops import ego_crops

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.models.pretrained import load_svegonet
from stages._contract import Context, Stage, Tables
from stages.train_svegonet import ON_AUTOMATIC, ON_MANUAL, STAGE, TrainSvegonetConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "train_svegonet.yaml"
SHORT = {"num_epochs": 3, "steps_per_epoch": 8, "batch_size": 4, "num_loaders": 0, "held_out_share": 0.25}
NET = {"backbone": "mobilenetv3_small_050", "num_levels": 2, "num_channels": 8, "image_size_px": 64, "num_depths": 8}
QUIET = {"turn_deg": 5.0, "flip_share": 0.0, "scale_spread": 0.02}


def _config(**changes: Any) -> TrainSvegonetConfig:
    values = yaml.safe_load(CONF.read_text())
    values["augmentation"] |= QUIET
    return TrainSvegonetConfig.model_validate(
        {**values, **SHORT, **NET, "from_imagenet": False, "backbone_from": None, **changes}
    )


def _named(crops: pa.Table, sequence_id: str) -> pa.Table:
    return crops.set_column(0, crops.schema.field(0), pa.array([sequence_id] * crops.num_rows))


def _inputs(splits: dict[str, str], manual: pa.Table, automatic: pa.Table) -> Tables:
    members = MEMBERS.from_rows([{"sequence_id": name, "split": split} for name, split in splits.items()])
    return {"members": members, "manual": manual, "automatic": automatic}


def _run(
    config: TrainSvegonetConfig, inputs: Tables, folder: Path, stage: Stage[TrainSvegonetConfig] = STAGE
) -> tuple[Tables, dict[str, Any]]:
    inputs = {role: inputs[role] for role in stage.inputs}
    made = stage.run(config, inputs, Context(folder, "all", 1, folder / "scratch"))
    return made, json.loads(made["weights"]["card"][0].as_py())


def test_it_learns_and_leaves_weights_that_can_be_read(tmp_path: Path) -> None:
    crops = _named(ego_crops(12), "a")
    config = _config(learning_rate=0.02, num_epochs=6)
    made, card = _run(config, _inputs({"a": "train"}, crops, EGO_CROPS.empty()), tmp_path, ON_MANUAL)
    loss = made["curve"]["loss"].to_pylist()
    assert loss[-1] < 0.85 * loss[0]
    assert (card["samples"], card["held_out"], card["labels"]) == (8, 3, "manual")  # frame 3 has no crop
    assert card["error_mm"] == pytest.approx(min(made["curve"]["error"].to_pylist()), abs=1e-3)
    assert load_svegonet(tmp_path / made["weights"]["weights_file"][0].as_py()).config.num_depths == 8


@pytest.mark.parametrize(
    ("stage", "splits", "samples", "held_out"),
    [
        (ON_MANUAL, {"a": "train", "b": "test"}, 8, 3),  # of a single sequence, the last frames
        (ON_AUTOMATIC, {"a": "train", "b": "train"}, 11, 11),  # otherwise whole ones
        (STAGE, {"a": "train", "b": "train"}, 22, 11),
        (ON_AUTOMATIC, {"a": "train", "b": "val"}, 11, 11),
        (STAGE, {"a": "manual_train", "b": "train"}, 11, 11),  # manual ones of a, automatic ones of b
        (ON_MANUAL, {"a": "manual_train", "b": "train"}, 8, 3),
    ],
)
def test_splits_and_labels_decide_what_is_learnt(
    tmp_path: Path, stage: Stage[TrainSvegonetConfig], splits: dict[str, str], samples: int, held_out: int
) -> None:
    manual = _named(ego_crops(12), "a")
    automatic = pa.concat_tables([manual, _named(manual, "b")])
    _, card = _run(_config(num_epochs=1), _inputs(splits, manual, automatic), tmp_path, stage)
    assert (card["samples"], card["held_out"]) == (samples, held_out)


def test_without_training_sequences_it_says_so(tmp_path: Path) -> None:
    inputs = _inputs({"a": "test"}, _named(ego_crops(6), "a"), EGO_CROPS.empty())
    with pytest.raises(
        ValueError, match="no sequence of split manual_train or train has egocentric crops with manual labels"
    ):
        _run(_config(), inputs, tmp_path, ON_MANUAL)
