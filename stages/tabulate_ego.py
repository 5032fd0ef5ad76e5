"""Make the table of an egocentric network: its errors on the sequences that it did not learn from (paper, Table 4)."""

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import MEMBERS
from assemblyhands_core.data.evaluation_tables import EGO_ERRORS, EVALUATION
from assemblyhands_core.data.members import judged_of
from assemblyhands_core.metrics.annotation import Resampling
from assemblyhands_core.metrics.egocentric import evaluate_egocentric
from stages._contract import Context, Stage, StageConfig, Tables


class TabulateEgoConfig(StageConfig):
    """Parameters of the intervals."""

    block_frames: int = Field(ge=1)
    num_resamples: int = Field(ge=100)
    seed: int = Field(ge=0)

    @property
    def resampling(self) -> Resampling:
        """Return how intervals are drawn."""
        return Resampling(self.block_frames, self.num_resamples, self.seed)


def run(config: TabulateEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Tabulate the errors on all sequences but those of the splits for training; on all, if there are no others."""
    names = pa.array(judged_of(inputs["members"]), pa.string())
    errors = pa.concat_tables([inputs["manual"], inputs["automatic"]])
    errors = errors.filter(pc.is_in(errors["sequence_id"], value_set=names))
    cells = evaluate_egocentric(errors, config.resampling)
    return {"metrics": EVALUATION.from_rows([{"sequence_id": context.sequence_id, **cell._asdict()} for cell in cells])}


STAGE = Stage(
    name="tabulate_ego",
    version=1,
    config=TabulateEgoConfig,
    inputs={"members": MEMBERS, "manual": EGO_ERRORS, "automatic": EGO_ERRORS},
    outputs={"metrics": EVALUATION},
    run=run,
    shard="set",
)
