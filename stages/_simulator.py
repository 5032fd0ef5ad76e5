"""What every stage that draws or scripts depends on beyond its config and tables: the simulator."""

from collections.abc import Mapping

from assemblyhands_core.synthetic.version import SIMULATOR_VERSION
from stages._contract import StageConfig


def simulator_externals(config: StageConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the simulator's version."""
    return {"simulator": str(SIMULATOR_VERSION)}
