"""Read who annotated what: the joints of an AssemblyHands `joint_3d` file, by frames of the recording's videos."""

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from assemblyhands_core.data.catalog import JOINTS, SOURCES, VIEWS
from assemblyhands_core.data.label_rows import as_joint_rows, first_key_of, keys_per_frame, label_rows, read_recording
from assemblyhands_core.data.training_tables import HAND_LABELS
from stages._contract import Context, Stage, StageConfig, Tables


class ReadLabelsConfig(StageConfig):
    """Parameters of reading."""

    first_key: int | None = Field(ge=0)


def run(config: ReadLabelsConfig, inputs: Tables, context: Context) -> Tables:
    """Read the labels of one sequence; a row for each hand at each frame with any joint of it.

    Raises:
        ValueError: The file lacks the sequence, or its keys are no frames of the videos.
    """
    (source,) = inputs["sources"].to_pylist()
    joints = read_recording(source, context.sequence_id)
    first_key = first_key_of(source, joints) if config.first_key is None else config.first_key
    step = keys_per_frame(_rate_hz(inputs["views"]))
    rows = label_rows(context.sequence_id, joints, first_key, step, source["source_file"])
    return {"labels": HAND_LABELS.from_rows(rows), "joints": JOINTS.from_rows(as_joint_rows(rows))}


def _rate_hz(views: pa.Table) -> float:
    return float(views.filter(pc.field("valid"))["rate_hz"][0].as_py())


STAGE = Stage(
    name="read_labels",
    version=2,
    config=ReadLabelsConfig,
    inputs={"sources": SOURCES, "views": VIEWS},
    outputs={"labels": HAND_LABELS, "joints": JOINTS},
    run=run,
    shard="sequence",
)
