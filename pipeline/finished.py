"""A run that has ended, as reports read it."""

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, cast

from pydantic import ValidationError

from pipeline.config import RigConfig, RunConfig, UserError
from pipeline.evaluation import kinds_of_sequences
from pipeline.history import History
from pipeline.manifests import listed
from pipeline.measured import Measured, measure
from pipeline.recordings import synthetic_sequences
from pipeline.view import LATEST
from stages import annotate_round, evaluate, tabulate_ego, tabulate_verbs
from stages._contract import StageConfig

_NEEDED: Final = (evaluate.STAGE, annotate_round.STAGE, tabulate_ego.STAGE, tabulate_verbs.STAGE)
"""Stages whose parameters reports need."""
_CHUNK: Final = re.compile(r"\.\d{5}$")


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run and what is known of it.

    Attributes:
        folder: Where it is.
        config: Of the run.
        kinds: Of its sequences, see `evaluation.pools`; empty where their manifest is not there anymore.
    """

    folder: Path
    config: RunConfig
    kinds: Mapping[str, str]

    @property
    def name(self) -> str:
        """Return its name."""
        return self.folder.name

    @cached_property
    def measured(self) -> Measured:
        """Return its annotation, held against the truth."""
        return measure(self.folder, self.kinds, self.settings)

    @cached_property
    def record(self) -> Mapping[str, Any]:
        """Return its ``run.json``: command, configuration, versions, digests, failures."""
        return read_record(self.folder)

    @cached_property
    def manifests(self) -> Mapping[str, Mapping[str, Any]]:
        """Return what each node's manifest says, in the order of the DAG as far as that is known."""
        found = {path.parent.name: json.loads(path.read_text()) for path in sorted(self.folder.glob("*/manifest.json"))}
        return {name: found[name] for name in [*self.record.get("digests", {}), *found] if name in found}

    @property
    def sequences(self) -> list[str]:
        """Return the sequences that it has anything of."""
        shards = (shard for manifest in self.manifests.values() for shard in manifest.get("shards", {}))
        return sorted({_CHUNK.sub("", shard) for shard in shards})

    def joint_reasons(self, node: str) -> Mapping[str, int]:
        """Return how many joints of a node have each reason, as its manifest says; the empty one is of those found."""
        counts: dict[str, int] = defaultdict(int)
        for shard in self.manifests.get(node, {}).get("shards", {}).values():
            for reason, count in shard["outputs"].get("joints", {}).get("reasons", {}).items():
                counts[reason] += count
        return counts

    @cached_property
    def is_synthetic(self) -> bool:
        """Return whether all that it measured is the studio's: truth is known of nothing else."""
        if any(self.folder.glob("evaluation_*/errors/*.parquet")):
            return True
        try:
            names = synthetic_sequences(self.config)
        except UserError:
            return False
        return bool(names) and names.issuperset(name for name in self.sequences if name in self.kinds)

    @property
    def settings(self) -> evaluate.EvaluateConfig:
        """Return how it was evaluated."""
        return cast(evaluate.EvaluateConfig, self.config.stages[evaluate.STAGE.name])

    @property
    def round_settings(self) -> annotate_round.AnnotateRoundConfig:
        """Return how its rounds were made."""
        return cast(annotate_round.AnnotateRoundConfig, self.config.stages[annotate_round.STAGE.name])

    @property
    def ego_settings(self) -> tabulate_ego.TabulateEgoConfig:
        """Return how its egocentric networks were judged."""
        return cast(tabulate_ego.TabulateEgoConfig, self.config.stages[tabulate_ego.STAGE.name])

    @property
    def verb_settings(self) -> tabulate_verbs.TabulateVerbsConfig:
        """Return how its verb classifiers were judged."""
        return cast(tabulate_verbs.TabulateVerbsConfig, self.config.stages[tabulate_verbs.STAGE.name])


def open_run(config: RunConfig, name: str) -> FinishedRun:
    """Return a run of the workspace, with the parameters that it ran with.

    Raises:
        UserError: there is no such run.
    """
    runs = config.workspace / "runs"
    folder = (runs / (name or LATEST)).resolve()
    if not (folder / "run.json").is_file():
        if not (there := [run.name for run in History(config.workspace).runs]):
            raise UserError(f"there is no run in {runs} yet; `make annotate` makes one")
        raise UserError(f"there is no run {name or LATEST} in {runs}; choose among {listed(there)}")
    config = _as_it_ran(config, folder)
    try:
        kinds = kinds_of_sequences(config)
    except UserError:  # its manifest was moved or has other rows now
        kinds = {}
    return FinishedRun(folder, config, kinds)


def read_record(folder: Path) -> Mapping[str, Any]:
    """Return a run's ``run.json``; nothing where there is none."""
    path = folder / "run.json"
    return cast(dict[str, Any], json.loads(path.read_text())) if path.is_file() else {}


def _as_it_ran(config: RunConfig, folder: Path) -> RunConfig:
    recorded = read_record(folder).get("config", {})
    rig = RigConfig(**recorded.get("rig", {"calibration": None, "videos": None}))
    own = {name: recorded[name] for name in ("seq", "target", "manifest", "rounds") if name in recorded}
    copy = config.model_copy(update={**own, "rig": rig})
    recorded_stages = recorded.get("stages", {})
    needed = {stage.name: _parameters(config.stages[stage.name], recorded_stages, stage.name) for stage in _NEEDED}
    copy._stages = {**config.stages, **needed}
    return copy


def _parameters(now: StageConfig, recorded: Mapping[str, Mapping[str, Any]], name: str) -> StageConfig:
    """Return a stage's parameters as recorded; those that were none then, or are none now, are today's."""
    values = now.model_dump(mode="json")
    known = {key: value for key, value in recorded.get(name, {}).items() if key in values}
    try:
        return type(now).model_validate_json(json.dumps(values | known))
    except ValidationError:
        return now
