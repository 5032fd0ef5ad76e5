"""What a stage is: a pure function from tables to tables, with its name, version, config and tables stated beside it.

A stage knows no path, no store, no scheduler and no other stage. It is called once per shard, so that shards may run in
any order, on any machine, and again after a crash.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypeVar

import pyarrow as pa
from pydantic import BaseModel, ConfigDict

from assemblyhands_core.data.tables import TableSpec

Tables = Mapping[str, pa.Table]
Sharding = Literal["sequence", "chunk", "set"]


class StageConfig(BaseModel):
    """Base of every stage's parameters: frozen, strict, unknown names refused. Values stand in ``conf/stage``."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def no_externals(config: StageConfig, sequence_id: str) -> Mapping[str, str]:
    """Return the externals of a stage that depends on its config and tables alone."""
    return {}


ConfigT = TypeVar("ConfigT", bound=StageConfig)


@dataclass(frozen=True)
class Context:
    """Where and with what a shard runs; nothing in here may change a result.

    Attributes:
        blob_dir: folder for files that belong to the result; rows refer to them by name.
        sequence_id: the shard's sequence, or what the set of all is called.
        num_threads: threads that the stage may use.
        scratch_dir: folder of this very computation that outlives a kill, for what lets a long one go on. Others may
            be at the same computation (`training.scratch`); the engine removes what is idle when the result is there.
    """

    blob_dir: Path
    sequence_id: str
    num_threads: int = 1
    scratch_dir: Path = Path("scratch")


@dataclass(frozen=True)
class Stage(Generic[ConfigT]):
    """A stage's declaration.

    Attributes:
        name: also the folder in the store and the name of its config file.
        version: raised whenever results change for equal inputs and config.
        config: class of its parameters.
        inputs: role → table.
        outputs: name → table; the first is what ``load(node)`` gives.
        run: ``run(config, inputs, context) -> outputs``.
        shard: one call per sequence, per chunk of frames of a sequence, or for the set of all sequences of a run.
        optional: roles that may be without rows. `inputs` lacks them then, and the result and its key are those of a
            stage that has no such role: what they add costs nobody anything who does not use it.
        is_quick: it takes no time and writes no blobs, so that `plan` may run it in order to tell what follows from it.
        uses_gpu: it is faster on a GPU; where some workers have one and others do not, it runs on those that have.
        externals: what the result depends on beyond config and tables (weights, package versions, files named in the
            config), as name → digest. Part of the cache key.
    """

    name: str
    version: int
    config: type[ConfigT]
    inputs: Mapping[str, TableSpec]
    outputs: Mapping[str, TableSpec]
    run: Callable[[ConfigT, Tables, Context], Tables]
    shard: Sharding
    externals: Callable[[ConfigT, str], Mapping[str, str]] = no_externals
    optional: frozenset[str] = frozenset()
    is_quick: bool = False
    uses_gpu: bool = False
