"""Take weights that are there already, shipped or of one's own, where otherwise a training would stand."""

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Final, Literal

from assemblyhands_core.data.catalog import WEIGHTS
from assemblyhands_core.data.digests import digest_file
from stages._contract import Context, Stage, StageConfig, Tables

Network = Literal["SVEgoNet", "MSG3D"]

_REPOSITORY: Final = Path(__file__).resolve().parents[1]
_TRAINED_BY: Final[Mapping[Network, str]] = {"SVEgoNet": "train_ego", "MSG3D": "train_verbs"}


class UseWeightsConfig(StageConfig):
    """Which weights."""

    svegonet: str
    msg3d: str

    def path(self, network: Network) -> Path:
        """Return the file; a relative path begins at the repository."""
        return _REPOSITORY / {"SVEgoNet": self.svegonet, "MSG3D": self.msg3d}[network]


def _run(network: Network, config: UseWeightsConfig, inputs: Tables, context: Context) -> Tables:
    """Copy the file, so that a result has what made it."""
    from assemblyhands_core.models.pretrained import read_card

    path = context.blob_dir / "weights.safetensors"
    path.write_bytes(config.path(network).read_bytes())
    card = json.dumps(dict(read_card(path)), sort_keys=True)
    row = {"sequence_id": context.sequence_id, "network": network, "weights_file": path.name, "card": card}
    return {"weights": WEIGHTS.from_rows([{**row, "sha256": digest_file(path)}])}


def _externals(network: Network, config: UseWeightsConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the digest of the weights.

    Raises:
        ValueError: There is no such file.
    """
    if not (path := config.path(network)).is_file():
        raise ValueError(
            f"there are no weights at {path}: train them (target={_TRAINED_BY[network]}), or set use_weights"
        )
    return {network: digest_file(path)}


def _stage(network: Network) -> Stage[UseWeightsConfig]:
    return Stage(
        name="use_weights",
        version=2,
        config=UseWeightsConfig,
        inputs={},
        outputs={"weights": WEIGHTS},
        run=partial(_run, network),
        shard="set",
        externals=partial(_externals, network),
    )


SVEGONET = _stage("SVEgoNet")
MSG3D = _stage("MSG3D")
