"""MS-G3D learns from the training sequences of a run alone, and says what it learnt."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml
from verb_clips import VERBS, clip_table, moving_clip, moving_table, unseen_clip

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.pose_sequences import PoseSequenceConfig
from assemblyhands_core.data.verb_clip_rows import clips_of
from assemblyhands_core.data.verb_tables import VERB_CLIPS
from assemblyhands_core.models.verb_classification import VerbClassifier
from stages._contract import Context, Tables
from stages.train_verbs import STAGE, TrainVerbsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "train_verbs.yaml"
SHORT = {"num_epochs": 1, "steps_per_epoch": 1, "batch_size": 6, "num_loaders": 0, "held_out_share": 0.25}
NET = {"num_frames": 8, "num_gcn_scales": 2, "num_g3d_scales": 2, "num_channels": (6, 6, 12), "dropout": 0.0}
QUIET = {"crop_share": 0.0, "speed_spread": 0.0, "turn_deg": 0.0}
LONGER = {"num_epochs": 2, "steps_per_epoch": 10, "learning_rate": 0.03}
A_TO_D = "abcd"


def _config(noise_mm: float = 1.0, **changes: Any) -> TrainVerbsConfig:
    values = yaml.safe_load(CONF.read_text())
    values["augmentation"] |= QUIET | {"noise_mm": noise_mm}
    values |= SHORT | NET | {"verbs": VERBS, "oversampling": {}, **changes}
    return TrainVerbsConfig.model_validate_json(json.dumps(values))


def _run(
    config: TrainVerbsConfig, splits: Mapping[str, str], clips: Sequence[pa.Table], folder: Path
) -> tuple[Tables, dict[str, Any]]:
    members = MEMBERS.from_rows([{"sequence_id": name, "split": split} for name, split in splits.items()])
    inputs = {"members": members, "clips": pa.concat_tables(clips)}
    made = STAGE.run(config, inputs, Context(folder, "all", 1, folder / "scratch"))
    return made, json.loads(made["weights"]["card"][0].as_py())


def _each(count: int = 4) -> list[pa.Table]:
    """Return so many clips of each of four sequences."""
    return [moving_table(name, count, 100 * place) for place, name in enumerate(A_TO_D)]


def test_obvious_verbs_are_learnt_and_the_file_can_be_used(tmp_path: Path) -> None:
    clips = [moving_table("a", 12), moving_table("b", 6, 500)]
    made, card = _run(_config(**LONGER), {"a": "train", "b": "val"}, clips, tmp_path)
    loss = made["curve"]["loss"].to_pylist()
    assert np.log(3) * 1.6 > loss[0] > 2 * loss[-1]
    assert card["error_percent"] == pytest.approx(min(made["curve"]["error"].to_pylist()), abs=1e-3) == 0.0
    classifier = VerbClassifier.load(tmp_path / made["weights"]["weights_file"][0].as_py())
    assert classifier.verbs == VERBS and classifier.nouns == ()
    assert classifier.sequence == PoseSequenceConfig(30, 0, 8, "fit", "segment", "bones", "skeleton")
    new = moving_table("c", 6, 900)
    found = classifier.probabilities([clip for _, clip in clips_of(new)], [""] * 6, 6, 1).argmax(axis=1)
    assert [VERBS[place] for place in found] == [segment.verb for segment, _ in clips_of(new)]


def test_the_card_says_what_the_network_is(tmp_path: Path) -> None:
    made, card = _run(_config(labels="shuffled"), {"a": "train"}, [moving_table("a", 12)], tmp_path)
    told = json.loads(card["classifier"])
    assert told["verbs"] == list(VERBS) and told["nouns"] == []
    assert (told["sequence"]["rate_hz"], told["sequence"]["num_frames"], told["sequence"]["graph"]) == (
        30,
        8,
        "skeleton",
    )
    assert card["start"] == "random" and card["training"]["labels"] == "shuffled"
    assert made["weights"]["network"].to_pylist() == ["MSG3D"]


@pytest.mark.parametrize(
    ("splits", "samples", "held_out"),
    [
        ({"a": "train", "b": "train", "c": "val", "d": "test"}, 8, 4),
        ({"a": "train", "b": "manual_train", "c": "manual_val", "d": "val"}, 8, 8),
        ({"a": "train", "b": "train", "c": "train", "d": "train"}, 12, 4),  # the last sequence of four
        ({"a": "train", "b": "test", "c": "test", "d": ""}, 3, 1),  # of a single one, the last segments
        ({"a": "train", "b": "val", "e": "val"}, 4, 4),  # e has no clips, and c and d are no members
    ],
)
def test_splits_decide_what_is_learnt(tmp_path: Path, splits: dict[str, str], samples: int, held_out: int) -> None:
    _, card = _run(_config(), splits, _each(), tmp_path)
    assert (card["samples"], card["held_out"]) == (samples, held_out)


def test_the_last_ones_are_held_out() -> None:
    """Whatever the order of rows."""
    from stages.train_verbs import _split

    members = MEMBERS.from_rows([{"sequence_id": name, "split": "train"} for name in A_TO_D])
    clips = pa.concat_tables(_each()[::-1])
    training, held_out = _split(_config(), {"members": members, "clips": clips})
    assert {one.recording for one, _ in held_out} == {"d"} and {one.recording for one, _ in training} == set("abc")
    inputs = {"members": members.slice(0, 1), "clips": clips.take(np.arange(clips.num_rows)[::-1])}
    training, held_out = _split(_config(), inputs)
    assert [one.number for one, _ in held_out] == [3] and [one.number for one, _ in training] == [0, 1, 2]


def test_rare_verbs_are_shown_more_often_in_training_alone(tmp_path: Path) -> None:
    clips = [moving_table("a", 7), moving_table("b", 6, 500)]
    _, card = _run(_config(oversampling={"screw": 4}), {"a": "train", "b": "val"}, clips, tmp_path)
    assert (card["samples"], card["held_out"]) == (7 + 3 * 2, 6)  # two of seven are screwed


def test_no_more_are_judged_than_told(tmp_path: Path) -> None:
    _, card = _run(_config(max_held_out=5), {"a": "train", "b": "val"}, _each(9), tmp_path)
    assert (card["samples"], card["held_out"]) == (9, 5)


def test_of_shuffled_labels_nothing_can_be_learnt(tmp_path: Path) -> None:
    clips = [moving_table("a", 24), moving_table("b", 24, 500)]
    made, card = _run(_config(labels="shuffled", **LONGER), {"a": "train", "b": "val"}, clips, tmp_path)
    assert 40.0 < card["error_percent"] < 80.0  # chance is 67
    assert made["curve"]["loss"].to_pylist()[-1] > 0.9  # ln 3 is 1.1


def test_a_control_starts_from_nothing() -> None:
    with pytest.raises(ValueError, match=r"weights/msg3d.safetensors has learnt from true labels: set start_from=null"):
        _config(labels="shuffled", start_from="weights/msg3d.safetensors")


def test_the_object_can_be_told_and_is_used(tmp_path: Path) -> None:
    """All clips are the same, so that the object alone tells the verb."""
    told, same = ["wheel", "bolt", "anvil"], [moving_clip("screw", 0)] * 3
    clips = [clip_table(name, VERBS, same, told) for name in "ab"]
    config = _config(noise_mm=0.0, object_cue=True, **{**LONGER, "learning_rate": 0.1})
    made, card = _run(config, {"a": "train", "b": "val"}, clips, tmp_path)
    assert json.loads(card["classifier"])["nouns"] == ["anvil", "bolt", "wheel"]
    assert card["error_percent"] == 0.0
    classifier = VerbClassifier.load(tmp_path / made["weights"]["weights_file"][0].as_py())
    found = classifier.probabilities(same, ["anvil", "wheel", "bolt"], 3, 1).argmax(axis=1)
    assert [VERBS[place] for place in found] == ["remove", "pick up", "screw"]


@pytest.mark.parametrize("splits", [{"a": "train", "b": "train"}, {"a": "train", "b": "val"}])
def test_clips_of_several_kinds_are_refused(tmp_path: Path, splits: dict[str, str]) -> None:
    with pytest.raises(
        ValueError, match=r"differ in rate and graph \(\[\(15, 'skeleton'\), \(30, 'skeleton'\)\]\): cut"
    ):
        _run(_config(), splits, [moving_table("a", 6), moving_table("b", 6, rate_hz=15)], tmp_path)
    landmarks = clip_table("b", ["screw"] * 4, [moving_clip("screw", n, "landmarks") for n in range(4)])
    with pytest.raises(ValueError, match=r"\(30, 'landmarks'\), \(30, 'skeleton'\)"):
        _run(_config(), splits, [moving_table("a", 6), landmarks], tmp_path)


def test_clips_without_poses_are_neither_learnt_from_nor_judged_by(tmp_path: Path) -> None:
    unseen = [unseen_clip()] * 3
    clips = [moving_table("a", 6), clip_table("b", VERBS, unseen), clip_table("c", VERBS, unseen)]
    _, card = _run(_config(), {"a": "train", "b": "train", "c": "val"}, clips, tmp_path)
    assert (card["samples"], card["held_out"]) == (5, 1)  # of a; neither b nor c can judge


@pytest.mark.parametrize(
    "clips", [moving_table("b", 6), VERB_CLIPS.empty(), clip_table("a", VERBS, [unseen_clip()] * 3)]
)
def test_without_anything_to_learn_from_there_is_no_network(tmp_path: Path, clips: pa.Table) -> None:
    members = MEMBERS.from_rows([{"sequence_id": "a", "split": "train"}, {"sequence_id": "b", "split": "test"}])
    made = STAGE.run(_config(), {"members": members, "clips": clips}, Context(tmp_path, "all", 1, tmp_path / "scratch"))
    assert {name: table.num_rows for name, table in made.items()} == {"weights": 0, "curve": 0}
    assert not list(tmp_path.iterdir())


def test_odd_requests_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a set of one take cannot be learnt from and judged by"):
        _run(_config(), {"a": "train"}, [moving_table("a", 1)], tmp_path)
    with pytest.raises(ValueError, match="clips of 'clap' are to occur 2 times; name a class"):
        _run(_config(oversampling={"clap": 2}), {"a": "train"}, [moving_table("a", 6)], tmp_path)
    with pytest.raises(ValueError, match="clips show 'remove', which is none of"):
        _run(_config(verbs=("pick up", "screw")), {"a": "train"}, [moving_table("a", 6)], tmp_path)


def test_training_goes_on_from_earlier_weights(tmp_path: Path) -> None:
    (tmp_path / "first").mkdir()
    made, _ = _run(_config(), {"a": "train"}, [moving_table("a", 12)], tmp_path / "first")
    path = str(tmp_path / "first" / made["weights"]["weights_file"][0].as_py())
    _, card = _run(_config(start_from=path), {"a": "train"}, [moving_table("a", 12)], tmp_path)
    assert card["start"] == path
    with pytest.raises(ValueError, match=r"is of a network with .*num_classes=3"):
        _run(_config(start_from=path, verbs=(*VERBS, "clap")), {"a": "train"}, [moving_table("a", 12)], tmp_path)
