"""A stage that takes weights which are there already, where otherwise a training would stand."""

import json
from collections.abc import Mapping
from functools import partial
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
        run=partial(_copied, network),
        shard="set",
        externals=partial(_externals, name, target),
    )


def _copied(network: str, config: UseWeightsConfig, inputs: Tables, context: Context) -> Tables:
    """Copy the file, so that a result has what made it."""
    from assemblyhands_core.models.weights_files import read_card

    path = context.blob_dir / "weights.safetensors"
    path.write_bytes(config.path.read_bytes())
    card = json.dumps(dict(read_card(path)), sort_keys=True)
    row = {"sequence_id": context.sequence_id, "network": network, "weights_file": path.name, "card": card}
    return {"weights": WEIGHTS.from_rows([{**row, "sha256": digest_file(path)}])}


def _externals(name: str, target: str, config: UseWeightsConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the digest of the weights.

    Raises:
        ValueError: There is no such file.
    """
    if not config.path.is_file():
        raise ValueError(
            f"there are no weights at {config.path}: train them (target={target}), or give {name}.weights=PATH"
        )
    return {"weights": digest_file(config.path)}
