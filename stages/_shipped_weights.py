"""A stage that takes weights which are there already, where otherwise a training would stand."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.training_tables import WEIGHTS
from stages._contract import Context, Stage, StageConfig, Tables

_REPOSITORY: Final = Path(__file__).resolve().parents[1]


class UseWeightsConfig(StageConfig):
    """Which weights; a relative path begins at the repository."""

    weights: str

    @property
    def path(self) -> Path:
        """Return the file."""
        return _REPOSITORY / self.weights


def shipped_weights_stage(name: str, network: str, target: str) -> Stage[UseWeightsConfig]:
    """Return the stage.

    Args:
        name: Its own.
        network: Whose weights these are.
        target: What trains them.
    """
    return Stage(
        name=name,
        version=1,
        config=UseWeightsConfig,
        inputs={},
        outputs={"weights": WEIGHTS},
        run=_Copy(network),
        shard="set",
        externals=_Digest(name, target),
    )


@dataclass(frozen=True)
class _Copy:
    """Copies the file, so that a result has what made it; a value, so that stages sent to workers compare equal."""

    network: str

    def __call__(self, config: UseWeightsConfig, inputs: Tables, context: Context) -> Tables:
        from assemblyhands_core.models.weights_files import read_card

        path = context.blob_dir / "weights.safetensors"
        path.write_bytes(config.path.read_bytes())
        card = json.dumps(dict(read_card(path)), sort_keys=True)
        row = {"sequence_id": context.sequence_id, "network": self.network, "weights_file": path.name, "card": card}
        return {"weights": WEIGHTS.from_rows([{**row, "sha256": digest_file(path)}])}


@dataclass(frozen=True)
class _Digest:
    """Gives the digest of the weights, or says how to get some."""

    stage: str
    target: str

    def __call__(self, config: UseWeightsConfig, sequence_id: str) -> Mapping[str, str]:
        if not config.path.is_file():
            raise ValueError(
                f"there are no weights at {config.path}: train them (target={self.target}), "
                f"or give {self.stage}.weights=PATH"
            )
        return {"weights": digest_file(config.path)}
