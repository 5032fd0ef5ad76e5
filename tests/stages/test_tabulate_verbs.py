"""The table of verbs: which rows count, from predictions that can be counted by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.verb_tables import VERB_PREDICTIONS
from stages._contract import Context
from stages.tabulate_verbs import SOURCES, STAGE, TabulateVerbsConfig

CONF = Path(__file__).parents[2] / "conf" / "stage" / "tabulate_verbs.yaml"
VERBS = ("pick up", "screw")
TRUE = ("pick up", "screw", "screw", "screw", "pick up")  # of each sequence
SAID = {
    "annotation": ("pick up", "screw", "screw", "screw", "screw"),
    "svegonet": ("pick up", "screw", "screw", "pick up", "screw"),
    "ego_only": ("pick up", "", "pick up", "pick up", "screw"),
}


def _predictions(sequence_id: str, said: tuple[str, ...], error_mm: float) -> pa.Table:
    return VERB_PREDICTIONS.from_rows(
        [
            {
                "sequence_id": sequence_id,
                "segment": number,
                "verb": verb,
                "predicted": predicted,
                "confidence": 0.8 if predicted else np.nan,
                "probability": np.full(24, 1 / 24 if predicted else np.nan),
                "first_key": 60 * number,
                "pose_error_mm": error_mm if predicted else np.nan,
                "coverage": 100.0 if predicted else 0.0,
            }
            for number, (verb, predicted) in enumerate(zip(TRUE, said, strict=True))
        ]
    )


def _inputs(sequences: dict[str, dict[str, tuple[str, ...]]]) -> dict[str, pa.Table]:
    """Return predictions by source of sequences, each with what its sources said."""
    found: dict[str, pa.Table] = {}
    for place, source in enumerate(SOURCES):
        tables = [_predictions(n, said[source], 10.0 * place) for n, said in sequences.items() if source in said]
        found[source] = pa.concat_tables([VERB_PREDICTIONS.empty(), *tables])
    return found


def _run(
    splits: dict[str, str], sequences: dict[str, dict[str, tuple[str, ...]]], **changes: Any
) -> dict[tuple[str, ...], Any]:
    return _tabulated(splits, _inputs(sequences), **changes)


def _tabulated(splits: dict[str, str], inputs: dict[str, pa.Table], **changes: Any) -> dict[tuple[str, ...], Any]:
    values = yaml.safe_load(CONF.read_text()) | {"verbs": VERBS, "num_resamples": 100} | changes
    config = TabulateVerbsConfig.model_validate_json(json.dumps(values))
    members = MEMBERS.from_rows([{"sequence_id": name, "split": split} for name, split in splits.items()])
    made = STAGE.run(config, {"members": members, **inputs}, Context(Path(), "all"))
    rows = made["metrics"].to_pylist()
    assert {row["sequence_id"] for row in rows} <= {"all"}
    return {tuple(row[name] for name in ("table", "group", "row", "metric")): row for row in rows}


def test_figures_of_each_source_counted_by_hand() -> None:
    found = _run({"a": "test"}, {"a": SAID})
    for source, right, error_mm in (("annotation", 4, 0.0), ("svegonet", 3, 10.0), ("ego_only", 1, 20.0)):
        accuracy, error = (found["verbs", "", source, metric] for metric in ("accuracy", "pose_error_mm"))
        assert accuracy["value"] == pytest.approx(100 * right / 5) and accuracy["n"] == 5
        assert error["value"] == pytest.approx(error_mm) and error["n"] == (4 if source == "ego_only" else 5)
    assert found["verbs", "", "ego_only", "pose_coverage"]["value"] == pytest.approx(80.0)
    assert found["verbs_by_verb", "screw", "svegonet", "accuracy"]["value"] == pytest.approx(200 / 3)
    assert found["verbs", "", "svegonet", "relative_accuracy"]["value"] == pytest.approx(75.0)
    assert found["verbs", "", "ego_only", "relative_accuracy"]["value"] == pytest.approx(25.0)
    assert found["verbs", "", "chance: most frequent verb", "accuracy"]["value"] == pytest.approx(60.0)
    assert found["verbs_confusion", "screw", "ego_only", "(none)"]["value"] == pytest.approx(100 / 3)


@pytest.mark.parametrize("split", ["train", "val", "manual_train", "manual_val"])
def test_what_was_learnt_from_is_left_out(split: str) -> None:
    wrong = dict.fromkeys(SOURCES, tuple("pick up" if verb == "screw" else "screw" for verb in TRUE))
    found = _run({"a": "test", "b": split}, {"a": SAID, "b": wrong})
    assert found["verbs", "", "annotation", "accuracy"]["value"] == pytest.approx(80.0)
    assert found["verbs", "", "annotation", "accuracy"]["n"] == 5
    both = _run({"a": "test", "b": ""}, {"a": SAID, "b": wrong})
    assert both["verbs", "", "annotation", "accuracy"]["value"] == pytest.approx(40.0)
    alone = _run({"b": split}, {"b": wrong})  # no others: better than nothing
    assert alone["verbs", "", "annotation", "accuracy"]["value"] == 0.0


def test_a_source_without_rows_is_absent() -> None:
    without = {source: said for source, said in SAID.items() if source != "ego_only"}
    found = _run({"a": "test"}, {"a": without})
    assert found["verbs", "", "svegonet", "relative_accuracy"]["value"] == pytest.approx(75.0)
    assert not [key for key in found if "ego_only" in " ".join(key)]
    bound_absent = _run({"a": "test"}, {"a": {"svegonet": SAID["svegonet"]}})
    assert bound_absent["verbs", "", "svegonet", "accuracy"]["value"] == pytest.approx(60.0)
    assert not [key for key in bound_absent if "relative_accuracy" in key]
    assert _run({"a": "test"}, {}) == {} == _run({"a": "test", "b": "train"}, {"b": SAID})


def test_a_sequence_that_a_source_lacks_does_not_count() -> None:
    sequences = {"a": SAID, "b": {source: said for source, said in SAID.items() if source != "svegonet"}}
    found = _run({"a": "test", "b": "test"}, sequences)
    assert {found["verbs", "", source, "accuracy"]["n"] for source in SOURCES} == {5}
    assert found["verbs", "", "annotation", "accuracy"]["value"] == pytest.approx(80.0)


def test_sources_of_other_segments_cannot_be_compared() -> None:
    inputs = _inputs({"a": SAID})
    inputs["svegonet"] = inputs["svegonet"].slice(0, 4)
    with pytest.raises(ValueError, match="svegonet has predictions of 4 segments, annotation of 5, and they are not"):
        _tabulated({"a": "test"}, inputs)


def test_a_verb_that_is_no_class_is_named() -> None:
    with pytest.raises(ValueError, match="the column verb has 'screw', which is none of the classes"):
        _run({"a": "test"}, {"a": SAID}, verbs=("pick up", "remove"))


def test_intervals_draw_whole_persons() -> None:
    names = [f"nusar-2021_action_both_{1000 + i}-c09a_{1000 + i}_user_id_2022-03-02_091830" for i in range(6)]
    wrong = dict.fromkeys(SOURCES, ("",) * 5)
    sequences = {name: SAID if place % 2 else wrong for place, name in enumerate(names)}
    cell = _run(dict.fromkeys(names, "test"), sequences)["verbs", "", "annotation", "accuracy"]
    assert cell["value"] == pytest.approx(40.0) and cell["n"] == 30
    assert 0.0 <= cell["low"] < 25.0 and 55.0 < cell["high"] <= 80.0
