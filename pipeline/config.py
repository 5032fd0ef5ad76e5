"""The run's configuration: Hydra composes it from ``conf``, strict frozen models check it."""

import difflib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from omegaconf import DictConfig, OmegaConf
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, field_validator

from assemblyhands_core.data.names import is_file_part
from assemblyhands_core.data.suspects import SuspicionLimits
from assemblyhands_core.hands.joints import NUM_JOINTS
from pipeline.dag import build_dag
from pipeline.executor_config import ExecutorConfig
from pipeline.graph import CROP_EDGE, TAKE_EDGE, Dag
from stages._contract import StageConfig

CONF_FOLDER = Path(__file__).resolve().parents[1] / "conf"


class UserError(ValueError):
    """Something that the user can put right; its message says what and how. Shown without a traceback."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class RigConfig(_Model):
    """A rig of one's own: one calibration file, and the videos as a glob; file names are the cameras' names."""

    calibration: str | None
    videos: str | None


class GcConfig(_Model):
    """What ``gc`` keeps: the results of the newest ``keep_runs`` runs, and what interrupted trainings go on from."""

    keep_runs: int = Field(ge=1)
    keep_scratch_days: float = Field(default=30.0, ge=0)
    dry_run: bool


class FsckConfig(_Model):
    """How ``fsck`` goes about it. ``num_threads`` 0 means one for each core."""

    num_threads: int = Field(default=0, ge=0)
    dry_run: bool = False


class ViewConfig(_Model):
    """What ``view`` writes for the viewer rerun."""

    first_frame: int = Field(default=0, ge=0)
    num_frames: int = Field(default=300, ge=1)
    step: int = Field(default=1, ge=1)
    pictures: bool = True
    max_side_px: int = Field(default=960, ge=16)
    jpeg_quality: int = Field(default=80, ge=1, le=100)


class SuspectsConfig(_Model):
    """Which hands ``suspects`` asks people about, see `suspects.SuspicionLimits`, and in how many pictures."""

    max_instants: int = Field(default=20, ge=1)
    min_gap_frames: int = Field(default=15, ge=1)
    max_views: int = Field(default=4, ge=1)
    min_confidence: float = Field(default=0.75, ge=0, le=1)
    max_distance_px: float = Field(default=15.0, gt=0)
    max_displacement_mm: float = Field(default=15.0, gt=0)
    min_joints: int = Field(default=NUM_JOINTS, ge=0, le=NUM_JOINTS)
    jpeg_quality: int = Field(default=95, ge=1, le=100)

    def limits(self) -> SuspicionLimits:
        """Return what is suspicious."""
        return SuspicionLimits(self.min_confidence, self.max_distance_px, self.max_displacement_mm, self.min_joints)


class RunConfig(_Model):
    """Everything but the stages' parameters, which are checked by their own classes."""

    seq: str
    target: str
    manifest: str | None
    release: Path | None
    hands2023_template: Path | None = None
    workspace: Path
    corrections: Path | None = None
    corrected: Path | None = None
    run: str
    check_space: bool = True
    other: str = ""
    ego_network: Literal["shipped", "trained"] = "shipped"
    ego_labels: tuple[Literal["manual", "automatic", "both"], ...] = ("both",)
    rounds: int = Field(ge=0, le=9)
    rig: RigConfig
    executor: ExecutorConfig
    gc: GcConfig
    fsck: FsckConfig = FsckConfig()
    view: ViewConfig = ViewConfig()
    suspects: SuspectsConfig = SuspectsConfig()
    _dag: Dag = PrivateAttr()
    _stages: Mapping[str, StageConfig] = PrivateAttr()

    @field_validator("corrected", mode="before")
    @classmethod
    def _named(cls, value: object) -> object:
        """Return None for no name, which `make correct` without FILE gives; as a path it would be this folder."""
        return value or None

    @property
    def dag(self) -> Dag:
        """Return the DAG that runs."""
        return self._dag

    @property
    def wanted_nodes(self) -> tuple[str, ...]:
        """Return the nodes that the target stands for."""
        return self._dag.targets.get(self.target, (self.target,))

    @property
    def starts_in_studio(self) -> bool:
        """Return whether the run starts from a manifest's orders instead of files."""
        return self.starts_from_crops or self._dag.reads(TAKE_EDGE, self.wanted_nodes)

    @property
    def starts_from_crops(self) -> bool:
        """Return whether the run starts from orders of crops for training."""
        return self._dag.reads(CROP_EDGE, self.wanted_nodes)

    @property
    def stages(self) -> Mapping[str, StageConfig]:
        """Return the checked parameters of every stage by its name."""
        return self._stages


def check_config(composed: DictConfig) -> RunConfig:
    """Return the frozen configuration of what Hydra composed: the run's own parameters and each stage's.

    Raises:
        UserError: naming the parameter, the value and what is allowed.
    """
    values = OmegaConf.to_container(composed, resolve=True)
    assert isinstance(values, dict)
    classes = {node.stage.name: node.stage.config for node in build_dag().nodes.values()}
    stages = {name: _validate(cls, values.pop(name), f"{name}.") for name, cls in classes.items()}
    config: RunConfig = _validate(RunConfig, values, "")
    _check_run_names(config)
    dag = build_dag(config.rounds, config.ego_network == "trained", config.ego_labels)
    config._dag, config._stages = dag, stages
    _check_target(config)
    return config


def unknown_key_message(overrides: Sequence[str], composed: DictConfig) -> str | None:
    """Return a sentence about the first override whose key does not exist, with the nearest valid name."""
    known = _flat_keys(OmegaConf.to_container(composed))
    for override in overrides:
        key, sign, _ = override.partition("=")
        if sign and not key.startswith(("hydra", "+", "~")) and key not in known and not chooses_file(override):
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5) or [k for k in known if key in k][:1]
            hint = f"; did you mean {near[0]}?" if near else "; `--cfg job` prints all parameters"
            return f"there is no parameter {key}{hint}"
    return None


def chooses_file(override: str) -> bool:
    """Return whether an override puts one file of ``conf`` in the place of another, as ``executor=serial`` does."""
    return (CONF_FOLDER / override.partition("=")[0].split("@")[0]).is_dir()


def _check_target(config: RunConfig) -> None:
    """Refuse what is neither a target nor a node; only targets are listed, as nodes are more than a hundred."""
    known = [*config.dag.targets, *config.dag.nodes]
    if config.target not in known:
        near = difflib.get_close_matches(config.target, known, n=1)
        hint = f" (did you mean {near[0]}?)" if near else ""
        raise UserError(
            f"target={config.target} is unknown{hint}; choose among {', '.join(config.dag.targets)}, "
            "or a node of `python -m pipeline describe`"
        )


def _check_run_names(config: RunConfig) -> None:
    """Refuse names of runs that lead elsewhere: a run takes the place of the folder of its name, whatever is in it."""
    for parameter, name in (("run", config.run), ("other", config.other)):
        if name and not is_file_part(name):
            raise UserError(
                f"{parameter}={name[:200]} cannot name a run: runs are folders of {config.workspace / 'runs'}; "
                "give the folder's name alone, short, without / and with no dot before it"
            )


def _validate(model: type[Any], values: Any, prefix: str) -> Any:
    try:
        return model.model_validate_json(json.dumps(values))
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "value_error" and isinstance(first["input"], dict):  # our own sentence about several values
            raise UserError(str(first["ctx"]["error"])) from None
        name = prefix + _place(first["loc"], values)
        raise UserError(f"{name}={first['input']!r} is not possible: {first['msg']}") from None


def _place(parts: Sequence[int | str], values: Any) -> str:
    """Return where a wrong value stands, without the names of classes that may stand there."""
    names = []
    for part in parts:
        if part is parts[-1] or (isinstance(values, Mapping) and part in values):
            names.append(str(part))
            values = values.get(part) if isinstance(values, Mapping) else None
    return ".".join(names)


def _flat_keys(values: Any, prefix: str = "") -> list[str]:
    if not isinstance(values, dict):
        return [prefix[:-1]]
    return ([prefix[:-1]] if prefix else []) + [k for n, v in values.items() for k in _flat_keys(v, f"{prefix}{n}.")]
