"""Stages and their files agree: values stand once in YAML, types and bounds once in the config class."""

import importlib
import json
import pickle
from pathlib import Path
from typing import Any

import hydra
import pytest
from omegaconf import OmegaConf
from pydantic import ValidationError

from assemblyhands_core import infer
from pipeline.config import CONF_FOLDER
from pipeline.dag import build_dag
from stages._contract import Stage
from stages._detector_config import DetectorConfig

STAGES_FOLDER = Path(__file__).resolve().parents[2] / "stages"
STAGES: dict[str, Stage[Any]] = {node.stage.name: node.stage for node in build_dag().nodes.values()}
WITH_DETECTOR = [name for name, stage in STAGES.items() if issubclass(stage.config, DetectorConfig)]


@pytest.fixture(scope="module")
def values() -> dict[str, Any]:
    """Return what Hydra composes when nothing is overridden."""
    with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        container = OmegaConf.to_container(hydra.compose("config"), resolve=True)
    assert isinstance(container, dict)
    return {str(name): value for name, value in container.items()}


def _config(name: str, values: dict[str, Any]) -> Any:
    return STAGES[name].config.model_validate_json(json.dumps(values))


@pytest.mark.parametrize("name", STAGES)
def test_a_stages_file_has_exactly_the_fields_of_its_class_and_is_valid(name: str, values: dict[str, Any]) -> None:
    file = OmegaConf.load(CONF_FOLDER / "stage" / f"{name}.yaml")
    assert set(file) == set(STAGES[name].config.model_fields)
    assert set(values[name]) == set(file)
    _config(name, values[name])


@pytest.mark.parametrize("name", STAGES)
def test_unknown_names_and_missing_ones_are_refused(name: str, values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="Extra inputs"):
        _config(name, values[name] | {"no_such_parameter": 1})
    for field in values[name]:
        with pytest.raises(ValidationError, match="Field required"):
            _config(name, {key: value for key, value in values[name].items() if key != field})


def test_pictures_are_cropped_alike_wherever_they_come_from(values: dict[str, Any]) -> None:
    assert values["project_ego"]["gamma"] == values["draw_ego_crops"]["gamma"] == infer.GAMMA


def test_every_stage_of_the_dag_has_a_file_and_every_file_a_stage() -> None:
    assert {path.stem for path in (CONF_FOLDER / "stage").iterdir()} == set(STAGES)
    assert {path.stem for path in STAGES_FOLDER.glob("[!_]*.py")} == set(STAGES)


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_is_called_like_its_module_and_can_be_sent_to_a_worker(name: str) -> None:
    module = importlib.import_module(f"stages.{name}")
    assert module.STAGE.name == name and any(value is STAGES[name] for value in vars(module).values())
    assert pickle.loads(pickle.dumps(STAGES[name])) == STAGES[name]


@pytest.mark.parametrize("name", STAGES)
def test_a_config_can_be_sent_to_a_worker_and_stays_as_it_is(name: str, values: dict[str, Any]) -> None:
    config = _config(name, values[name])
    assert pickle.loads(pickle.dumps(config)) == config
    with pytest.raises(ValidationError, match="frozen"):
        setattr(config, next(iter(values[name]), "anything"), None)


@pytest.mark.parametrize("name", WITH_DETECTOR)
def test_an_unknown_detector_is_refused_with_those_there_are(name: str, values: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="choose one of auto, mediapipe, learned, rtmlib, precomputed"):
        _config(name, values[name] | {"detector": "openpose"})


@pytest.mark.parametrize("name", WITH_DETECTOR)
def test_only_the_options_of_the_detector_that_runs_are_part_of_the_key(name: str, values: dict[str, Any]) -> None:
    config = _config(name, values[name] | {"detector": "precomputed"})
    assert config.model_dump(mode="json")["options"] == {"precomputed": values[name]["options"]["precomputed"]}
    other = {**values[name]["options"], "rtmlib": {"mode": "performance"}}
    assert _config(name, values[name] | {"options": other}).model_dump() == _config(name, values[name]).model_dump()


def test_the_audit_uses_the_detector_of_the_run_unless_told_otherwise() -> None:
    overrides = ["detect_hands.detector=precomputed", "detect_hands.options.precomputed.root='/data/{sequence_id}'"]
    with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        composed = hydra.compose("config", overrides)
        apart = hydra.compose("config", [*overrides, "audit_recording.detector=mediapipe"])
    config = _config("audit_recording", OmegaConf.to_container(composed.audit_recording, resolve=True))
    assert config.detector == "precomputed"
    assert config.detector_options("monday") == {"root": "/data/monday"}
    assert apart.audit_recording.detector == "mediapipe"
