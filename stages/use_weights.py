"""Take weights that are there already, shipped or of one's own, where otherwise a training would stand."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from assemblyhands_core.data.catalog import WEIGHTS
from assemblyhands_core.data.digests import digest_file
from stages._contract import Context, Stage, StageConfig, Tables

_REPOSITORY: Final = Path(__file__).resolve().parents[1]


class UseWeightsConfig(StageConfig):
    """Which weights."""

    svegonet: str

    @property
    def path(self) -> Path:
        """Return the file; a relative path begins at the repository."""
        return _REPOSITORY / self.svegonet


def run(config: UseWeightsConfig, inputs: Tables, context: Context) -> Tables:
    """Copy the file, so that a result has what made it."""
    from assemblyhands_core.models.pretrained import read_card

    path = context.blob_dir / "weights.safetensors"
    path.write_bytes(config.path.read_bytes())
    card = json.dumps(dict(read_card(path)), sort_keys=True)
    row = {"sequence_id": context.sequence_id, "network": "SVEgoNet", "weights_file": path.name, "card": card}
    return {"weights": WEIGHTS.from_rows([{**row, "sha256": digest_file(path)}])}


def externals(config: UseWeightsConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the digest of the weights.

    Raises:
        ValueError: There is no such file.
    """
    if not config.path.is_file():
        raise ValueError(f"there are no weights at {config.path}: train them (target=train_ego), or set use_weights")
    return {"svegonet": digest_file(config.path)}


STAGE = Stage(
    name="use_weights",
    version=1,
    config=UseWeightsConfig,
    inputs={},
    outputs={"weights": WEIGHTS},
    run=run,
    shard="set",
    externals=externals,
)
