"""Make the table of verb classification: each source of poses on the sequences that nothing was learnt from."""

from typing import Final

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.evaluation_tables import EVALUATION
from assemblyhands_core.data.members import judged_of
from assemblyhands_core.data.verb_tables import VERB_PREDICTIONS
from assemblyhands_core.metrics.verb_rows import Blocks
from assemblyhands_core.metrics.verbs import VerbEvaluation, evaluate_verbs
from stages._contract import Context, Stage, StageConfig, Tables

SOURCES: Final = ("annotation", "svegonet", "ego_only")
"""Whose poses: our annotation (the upper bound), SVEgoNet's, and those triangulated in the headset's cameras alone."""


class TabulateVerbsConfig(StageConfig):
    """Parameters of the figures."""

    verbs: tuple[str, ...]
    blocks: Blocks
    num_resamples: int = Field(ge=100)
    num_bins: int = Field(ge=2)
    seed: int = Field(ge=0)

    @property
    def evaluation(self) -> VerbEvaluation:
        """Return how verbs are evaluated."""
        return VerbEvaluation(
            verbs=self.verbs,
            upper_bound=SOURCES[0],
            blocks=self.blocks,
            num_resamples=self.num_resamples,
            seed=self.seed,
            num_bins=self.num_bins,
        )


def run(config: TabulateVerbsConfig, inputs: Tables, context: Context) -> Tables:
    """Tabulate the sequences that are not for training; all, if there are no others.

    Of these, the ones that every source has that has any: those filmed without a headset have annotation alone.
    """
    names = set(judged_of(inputs["members"]))
    found = [set(inputs[source]["sequence_id"].to_pylist()) & names for source in SOURCES]
    common = pa.array(sorted(names.intersection(*filter(None, found))), pa.string())
    tables = []
    for source in SOURCES:
        rows = inputs[source].filter(pc.is_in(inputs[source]["sequence_id"], value_set=common))
        tables.append(rows.append_column("source", pa.array([source] * rows.num_rows, pa.string())))
    cells = evaluate_verbs(pa.concat_tables(tables), config.evaluation)
    return {"metrics": EVALUATION.from_rows([{"sequence_id": context.sequence_id, **cell._asdict()} for cell in cells])}


STAGE = Stage(
    name="tabulate_verbs",
    version=2,
    config=TabulateVerbsConfig,
    inputs={"members": MEMBERS, **dict.fromkeys(SOURCES, VERB_PREDICTIONS)},
    outputs={"metrics": EVALUATION},
    run=run,
    shard="set",
)
